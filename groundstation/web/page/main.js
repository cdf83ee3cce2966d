// The page of the ground station: joins the stream, the map, the panels and the actions. It decides nothing; what it
// shows is what the ground station tells, and what it asks is a command that the ground station may refuse.

import { Actions, radiiOf } from "./actions.js";
import { get, remove } from "./api.js";
import { logIn, prepareDialog } from "./dialog.js";
import { byId, el, setAttribute, setText } from "./dom.js";
import { clock, dayTime, latLon, position, seconds, thing, words } from "./format.js";
import { MissionMap } from "./map.js";
import { addEvents, isUnsigned, nothing, take, takeTrails } from "./model.js";
import { BroadcastPanel, detailFacts, Facts, stripWords, Tables, UnknownList, whyWords } from "./panels.js";
import { Playback } from "./playback.js";
import { Stream } from "./stream.js";
import { Tabs } from "./tabs.js";
import { followTheme } from "./theme.js";
import { Timeline } from "./timeline.js";

const TOAST_MS = 8000;
const WHY_EVERY_MS = 1000; // how often an open "why?" is asked again
const NARROW = matchMedia("(max-width: 599px), (max-width: 899px) and (max-height: 599px)"); // as the style sheet
const DIRECTIVES = [
  ["hold", "hold", "Hold"],
  ["return", "recall", "Recall", { class: "danger" }],
  ["normal", "normal", "Normal"],
];
const KINDS = { agent: "agents", target: "targets", threat: "threats" };

class Page {
  constructor() {
    this.state = nothing();
    this.rights = { name: "", role: "observer" };
    this.chosen = null;
    this.ageS = 0;
    this.isStale = false;
    this.whyOpen = false;
    this.map = new MissionMap(byId("map"), this.state, {
      choose: (mark) => this.chooseMark(mark),
      point: (place, latLng) => this.showPointer(place, latLng),
      dragRadii: (mark) => this.dragRadii(mark),
      chosenItem: () => this.itemOf(this.chosen),
      moved: (mark, place) => this.actions.move(mark.kind, this.itemOf(mark), place),
    });
    this.actions = new Actions(this);
    this.makePanels();
    this.bind();
    followTheme(byId("theme"), () => this.map.readPalette());
    this.start();
  }

  makePanels() {
    prepareDialog();
    this.tables = new Tables((kind, item) => this.choose(kind, item.id));
    for (const name of ["agents", "targets", "threats", "sources"]) {
      byId(`${name}-table`).append(this.tables[name].element);
    }
    this.unknown = new UnknownList(byId("unknown"), byId("no-unknown"), (one) => this.actions.takeIn(one));
    this.broadcast = new BroadcastPanel({
      meter: byId("rate-meter"),
      facts: byId("broadcast-facts"),
      items: byId("items-table"),
    });
    this.facts = new Facts(byId("details-facts"));
    this.timeline = new Timeline(byId("events"), (event, text) => this.actions.undo(event, text));
    this.playback = new Playback(byId("playback"), (why) => this.warn(why));
    this.tabs = new Tabs(document.querySelector("[role=tablist]"), () => this.map?.request());
    this.tabs.show(NARROW.matches ? "map" : "agents");
    NARROW.addEventListener("change", () => {
      if (!NARROW.matches && this.tabs.current === "map") this.tabs.show("agents");
    });
  }

  bind() {
    const on = (id, act) => byId(id).addEventListener("click", act);
    on("hold-all", () => this.actions.direct("hold"));
    on("recall-all", () => this.actions.direct("return"));
    on("normal-all", () => this.actions.direct("normal"));
    on("pause", () => this.actions.pause(this.state.picture?.paused));
    on("add-target", () => this.pickFor("target"));
    on("add-threat", () => this.pickFor("threat"));
    on("form-target", () => this.actions.add("target"));
    on("form-threat", () => this.actions.add("threat"));
    on("fit", () => this.map.fit());
    on("pick-cancel", () => this.map.endPick(null));
    on("log-out", () => this.logOut());
    on("details-close", () => this.closeDetails());
    for (const box of document.querySelectorAll("[data-layer]")) {
      box.addEventListener("change", () => {
        this.map.ui.layers[box.dataset.layer] = box.checked;
        this.map.request();
      });
    }
    byId("agent-filter").addEventListener("input", () => this.showTables());
    byId("agent-state").addEventListener("change", () => this.showTables());
    byId("event-filter").addEventListener("input", () => this.showEvents());
    setInterval(() => this.askWhy(), WHY_EVERY_MS);
  }

  async start() {
    this.showRights();
    await this.learnRights();
    if (this.rights.tiles) this.map.layTiles();
    this.stream = new Stream("/api/v1/stream", {
      onMessage: (message) => this.heard(message),
      onState: (...now) => this.connection(...now),
      onShutOut: () => this.letIn(),
    });
  }

  /** Who looks, and what that name may do: the ground station holds to it whatever the page shows. */
  async learnRights() {
    try {
      this.rights = await get("/session");
    } catch (problem) {
      if (problem.status !== 401) this.warn(problem.message);
      else this.rights = await logIn();
    }
    this.showRights();
  }

  /** A session that ended: the page goes on where it was, once somebody has logged in again. */
  async letIn() {
    await this.learnRights();
    this.stream.open();
  }

  async logOut() {
    try {
      await remove("/session");
    } catch (problem) {
      this.warn(problem.message);
      return;
    }
    location.reload();
  }

  get mayAct() {
    const { picture, playback } = this.state;
    return this.rights.role === "operator" && picture?.mode !== "playback" && !playback?.over;
  }

  showRights() {
    document.body.classList.toggle("observer", !this.mayAct);
    byId("orders").hidden = !this.mayAct;
    byId("log-out").hidden = !this.rights.login;
    setText(byId("who"), this.rights.login ? `${this.rights.name}, ${this.rights.role}` : "");
    for (const element of document.querySelectorAll(".operator")) element.hidden = !this.mayAct;
  }

  heard(message) {
    const changed = take(this.state, message);
    if (changed === null) return;
    if (changed === "picture") this.showPicture();
    if (changed === "playback") this.showPlayback();
    if (changed === "timeline" || changed === "playback") this.playback.showEvents(this.state.timeline);
    if (changed === "event" || changed === "playback") this.showEvents();
    this.showClock();
    this.map.request();
  }

  showClock() {
    const zone = this.tellsDay ? " UTC" : "";
    setText(byId("clock"), this.timeOf(this.state.nowS) + zone);
  }

  /** Whether times are those of the day: those of a simulated or recorded flight are told since its beginning. */
  get tellsDay() {
    return this.state.picture?.mode === "live" || !this.state.playback;
  }

  timeOf(unixS) {
    return this.tellsDay ? dayTime(unixS) : clock(Math.max(0, unixS - this.state.playback.from_s));
  }

  showPicture() {
    const { picture } = this.state;
    if (!this.hasTrails) this.askTrails();
    document.title = `${picture.mission} – ground station`;
    setText(byId("mission"), picture.mission);
    byId("unsigned").hidden = !isUnsigned(picture);
    setText(byId("directive"), picture.paused ? "PAUSED" : words(String(picture.directive)));
    setAttribute(byId("directive"), "data-directive", picture.paused ? "paused" : picture.directive);
    setText(byId("pause"), picture.paused ? "Resume" : "Pause");
    setText(byId("strip"), stripWords(picture));
    this.showRights();
    this.broadcast.show(picture);
    this.unknown.show(picture.unknown ?? [], this.mayAct);
    this.showWarnings(picture.warnings ?? []);
    byId("no-sources").hidden = (picture.sources ?? []).length > 0;
    this.showTables();
    this.showDetails();
    this.showEvents();
    this.showPlayback();
    if (this.lastEvent !== picture.event) this.askEvents(picture.event);
  }

  showMode() {
    const { picture, playback } = this.state;
    const mode = { live: "live", sim: "simulator", playback: "playback" }[picture.mode] ?? picture.mode;
    setText(byId("mode"), playback?.over ? "flight over" : mode);
  }

  /** The trails from before this page was opened. */
  async askTrails() {
    this.hasTrails = true;
    try {
      takeTrails(this.state, (await get("/trails")).agents);
      this.map.request();
    } catch (problem) {
      this.warn(problem.message);
    }
  }

  /** Events that came while nobody listened. */
  async askEvents(last) {
    const after = this.state.events.length ? this.state.events.at(-1).number : 0;
    this.lastEvent = last;
    if (after >= last && after > 0) return;
    try {
      addEvents(this.state, await get(`/events?after=${after}`));
      this.showEvents();
    } catch (problem) {
      this.warn(problem.message);
    }
  }

  showTables() {
    if (!this.state.picture) return;
    const filter = { text: byId("agent-filter").value, state: byId("agent-state").value };
    this.tables.show(this.state, this.chosen, filter);
    const [shown, all] = [this.tables.agents.rows.size, this.state.agents.size];
    setText(byId("agent-count"), shown === all ? `${all}` : `${shown} of ${all}`);
    for (const kind of Object.values(KINDS)) setText(byId(`tab-${kind}`), `${title(kind)} ${this.state[kind].size}`);
    const unknown = (this.state.picture.unknown ?? []).length;
    setAttribute(byId("tab-threats"), "data-extra", unknown ? `${unknown}?` : null);
  }

  showEvents() {
    const undoable = this.mayAct ? (this.state.picture?.undoable ?? []) : [];
    this.timeline.show(this.state.events, undoable, byId("event-filter").value, (unixS) => this.timeOf(unixS));
  }

  showPlayback() {
    const mode = this.state.picture?.mode;
    if (mode) this.showMode();
    if (this.state.playback?.over !== this.toldOver) {
      this.toldOver = this.state.playback?.over;
      this.showRights();
      this.showDetails();
    }
    this.playback.show(this.state.playback, mode, mode === "playback" || this.mayAct);
    if (this.stream) this.stream.quietAllowed = this.state.playback?.playing === false;
  }

  showWarnings(warnings) {
    const list = byId("warnings");
    if (list.dataset.told !== warnings.join("\n")) {
      list.dataset.told = warnings.join("\n");
      list.replaceChildren(...warnings.map((text) => el("li", {}, text)));
    }
    byId("no-warnings").hidden = warnings.length > 0;
    setAttribute(byId("tab-warnings"), "data-extra", warnings.length || null);
  }

  connection(now, ageS) {
    this.ageS = ageS;
    this.isStale = now === "stale";
    document.body.classList.toggle("stale", this.isStale);
    const line = byId("stale");
    line.hidden = !this.isStale;
    const since = seconds(Math.floor(ageS));
    const last = this.state.events.at(-1);
    const why = last?.event === "stopped" ? `It was told to stop${last.reason ? ` (${last.reason})` : ""}. ` : "";
    setText(line, this.isStale ? `No word from the ground station for ${since}. ${why}What stands here is old.` : "");
    setText(byId("connection"), this.isStale ? "no connection" : "connected");
    setAttribute(byId("connection"), "data-state", now);
  }

  staleWarning() {
    return this.isStale ? `What you see is ${seconds(Math.floor(this.ageS))} old.` : "";
  }

  itemOf(chosen) {
    const kind = KINDS[chosen?.kind];
    return kind ? (this.state[kind].get(String(chosen.id)) ?? null) : null;
  }

  chooseMark(mark) {
    if (mark === null) this.closeDetails();
    else if (mark.kind === "unknown") this.tabs.show("threats");
    else this.choose(mark.kind, mark.id);
  }

  choose(kind, id) {
    if (!KINDS[kind]) return;
    const isOther = this.chosen?.kind !== kind || String(this.chosen?.id) !== String(id);
    this.chosen = { kind, id };
    if (isOther) this.whyOpen = false;
    this.map.choose(this.chosen);
    const item = this.itemOf(this.chosen);
    if (item) this.map.show(item.north_m, item.east_m);
    this.showTables();
    this.showDetails(isOther);
  }

  closeDetails() {
    const hadFocus = byId("details").contains(document.activeElement);
    this.chosen = null;
    this.whyOpen = false;
    this.map.choose(null);
    this.showTables();
    this.showDetails(true);
    if (hadFocus) byId(`tab-${this.tabs.current}`).focus();
  }

  showDetails(isOther = false) {
    const item = this.itemOf(this.chosen);
    const panel = byId("details");
    panel.hidden = item === null;
    if (item === null) return;
    const { kind } = this.chosen;
    setText(byId("details-title"), title(thing(kind, item)));
    this.facts.show(detailFacts(kind, item, this.state.plane));
    const told = [kind, item.id, item.state, item.directive, item.pinned, this.mayAct, this.whyOpen].join();
    if (isOther || this.toldActions !== told) {
      this.toldActions = told;
      this.showActions(kind, item);
    }
    byId("why").hidden = !this.whyOpen;
  }

  showActions(kind, item) {
    const place = byId("details-actions");
    const focused = place.contains(document.activeElement) ? document.activeElement.dataset.act : null;
    const button = (act, text, onclick, properties = {}) =>
      el("button", { type: "button", "data-act": act, onclick, ...properties }, text);
    const opens = { "aria-expanded": String(this.whyOpen), "aria-controls": "why" };
    const why = button("why", "Why?", () => this.toggleWhy(), opens);
    const live = this.mayAct ? (kind === "agent" ? this.agentButtons(button) : this.thingButtons(button, kind)) : [];
    place.replaceChildren(...(kind === "agent" ? [why] : []), ...live);
    if (focused) place.querySelector(`[data-act="${focused}"]`)?.focus();
  }

  agentButtons(button) {
    const item = () => this.itemOf(this.chosen);
    const agent = item();
    const isOut = agent.state === "out";
    return [
      button("pin", "Pin…", () => this.actions.pin(item())),
      isOut
        ? button("put-back", "Put back", () => this.actions.putBack(item()))
        : button("take-out", "Take out", () => this.actions.takeOut(item()), { class: "danger" }),
      ...DIRECTIVES.filter(([directive]) => directive !== agent.directive).map(([directive, act, text, properties]) =>
        button(act, text, () => this.actions.direct(directive, item()), properties),
      ),
    ];
  }

  thingButtons(button, kind) {
    const item = () => this.itemOf(this.chosen);
    return [
      button("move", "Move on the map", () => this.pickToMove(kind, item())),
      button("change", "Change…", () => this.actions.change(kind, item())),
      button("retire", "Retire", () => this.actions.retire(kind, item()), { class: "danger" }),
    ];
  }

  toggleWhy() {
    this.whyOpen = !this.whyOpen;
    byId("why").replaceChildren(el("p", { class: "quiet" }, "Asking…"));
    this.showDetails();
    this.askWhy();
  }

  async askWhy() {
    if (!this.whyOpen || this.chosen?.kind !== "agent" || this.asking) return;
    const { id } = this.chosen;
    this.asking = true;
    let shown;
    try {
      shown = whyWords(await get(`/why/${encodeURIComponent(id)}`));
    } catch (problem) {
      shown = el("p", { class: "refusal" }, problem.message);
    }
    this.asking = false;
    if (!this.whyOpen || this.chosen?.id !== id) return;
    const wasOpen = byId("why").querySelector("details")?.open ?? false;
    byId("why").replaceChildren(shown);
    const more = byId("why").querySelector("details");
    if (more) more.open = wasOpen;
  }

  /** The circles of what may be dragged; null for what may not. */
  dragRadii(mark) {
    if (!this.mayAct || (mark.kind !== "target" && mark.kind !== "threat")) return null;
    const item = this.itemOf(mark);
    return item ? radiiOf(mark.kind, item) : null;
  }

  pickFor(kind) {
    const radii = kind === "threat" ? [1000, 500] : [this.state.picture?.arrival_radius_m ?? 0];
    this.pick(radii, (place) => this.actions.add(kind, place));
  }

  pickToMove(kind, item) {
    this.pick(radiiOf(kind, item), (place) => this.actions.move(kind, item, place));
  }

  pick(radii, done) {
    if (!this.state.picture) return;
    const before = document.activeElement;
    if (NARROW.matches) this.tabs.show("map");
    byId("picking").hidden = false;
    this.map.pick(radii, (place) => {
      byId("picking").hidden = true;
      before?.focus?.({ preventScroll: true });
      if (place !== null) done(place);
    });
  }

  showPointer(place, latLng) {
    setText(byId("pointer"), `${position(place.north_m, place.east_m)} · ${latLon(latLng.lat, latLng.lng)}`);
  }

  /** Says that an action was accepted, with a way back. */
  told(text, event) {
    const undo = el("button", { type: "button", onclick: () => this.actions.undo(event, text) }, "Undo");
    this.toast(text, event && !event.undoes ? undo : null);
    if (event?.number) {
      addEvents(this.state, [event]);
      this.showEvents();
    }
  }

  warn(text) {
    this.toast(text, null);
  }

  toast(text, button) {
    const toast = byId("toast");
    toast.replaceChildren(el("span", {}, text), ...(button ? [button] : []));
    toast.hidden = false;
    clearTimeout(this.toastTimer);
    this.toastTimer = setTimeout(() => (toast.hidden = true), TOAST_MS);
  }
}

function title(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

// For the tests, which measure how long a drawing takes.
window.groundStationPage = new Page();
