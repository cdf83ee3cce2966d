// The panels beside the map: what is in the picture, in words and numbers.

import { el, inOrder, setText } from "./dom.js";
import { anyValue, bytes, metres, NONE, percent, position, rate, seconds, words } from "./format.js";
import { isGhost, sourceWords } from "./model.js";
import { Table } from "./table.js";

const speedOf = (item) => Math.hypot(item.velocity_north_m_s ?? 0, item.velocity_east_m_s ?? 0);
const radiiWords = (threat) => `${metres(threat.attack_radius_m)} / ${metres(threat.detection_radius_m)}`;
const ids = (list) => (list?.length ? list.join(", ") : NONE);

/** How much of what is sent an agent is taken to hear; of a flight that was recorded on board, what it had heard. */
function linkShare(agent) {
  if (typeof agent.link === "string") return agent.link;
  return agent.link ? percent(agent.link.heard) : NONE;
}

function linkWords(agent) {
  if (!agent.link) return "not known: it cannot answer";
  if (typeof agent.link === "string") return agent.link;
  const { heard, by } = agent.link;
  const source = { reports: "as much as of its reports", mission: "as the mission declares" }[by] ?? by;
  return `hears ${percent(heard)}, ${source}`;
}

function stateWords(agent) {
  const directive = agent.directive && agent.directive !== "normal" ? `, ${agent.directive}` : "";
  return `${agent.state}${directive}`;
}

const AGENT_COLUMNS = [
  { id: "id", title: "Agent", text: (a) => a.id, sort: (a) => a.id },
  { id: "state", title: "State", text: stateWords, sign: (a) => a.state, long: true },
  {
    id: "target",
    title: "Target",
    text: (a) => (a.target === null ? NONE : `${a.target}${a.pinned === null ? "" : " pinned"}`),
    sort: (a) => a.target,
  },
  { id: "by", title: "Position", text: sourceWords, sign: (a) => (isGhost(a) ? "ghost" : a.source), long: true },
  { id: "age", title: "Age", text: (a) => seconds(a.age_s), sort: (a) => a.age_s },
  { id: "range", title: "Range", text: (a) => metres(a.range_left_m), sort: (a) => a.range_left_m, hide: true },
  { id: "link", title: "Link", text: linkShare, hide: true, long: true },
  { id: "eta", title: "ETA", text: (a) => seconds(a.eta_s), sort: (a) => a.eta_s, hide: true },
];

const TARGET_COLUMNS = [
  { id: "id", title: "Target", text: (t) => t.id, sort: (t) => t.id },
  { id: "name", title: "Name", text: (t) => t.name ?? "", long: true },
  { id: "agents", title: "Agents", text: (t) => ids(t.agents) },
  { id: "reached", title: "Reached by", text: (t) => ids(t.reached_by) },
  { id: "speed", title: "Speed", text: (t) => rate(speedOf(t), "m/s"), sort: speedOf, hide: true },
  { id: "age", title: "Age", text: (t) => seconds(t.age_s), sort: (t) => t.age_s },
  { id: "source", title: "Source", text: (t) => t.source ?? "", hide: true, long: true },
];

const THREAT_COLUMNS = [
  { id: "id", title: "Threat", text: (t) => t.id, sort: (t) => t.id },
  { id: "name", title: "Name", text: (t) => t.name ?? "", long: true },
  { id: "radii", title: "Attack / detection", text: radiiWords, sort: (t) => t.detection_radius_m },
  { id: "growth", title: "Grown by", text: (t) => metres(t.growth_m), sort: (t) => t.growth_m },
  { id: "speed", title: "Speed", text: (t) => rate(speedOf(t), "m/s"), sort: speedOf, hide: true },
  { id: "age", title: "Age", text: (t) => seconds(t.age_s), sort: (t) => t.age_s },
  { id: "source", title: "Source", text: (t) => t.source ?? "", hide: true, long: true },
];

const SOURCE_COLUMNS = [
  { id: "id", title: "Source", text: (s) => s.name },
  { id: "kind", title: "Kind", text: (s) => s.kind, hide: true },
  { id: "state", title: "State", text: (s) => s.state, sign: (s) => s.state },
  { id: "rate", title: "Rate", text: (s) => rate(s.rate_hz, "Hz"), sort: (s) => s.rate_hz },
  { id: "age", title: "Age", text: (s) => seconds(s.age_s), sort: (s) => s.age_s },
  { id: "things", title: "Things", text: (s) => s.things ?? 0, sort: (s) => s.things },
  { id: "refused", title: "Refused", text: (s) => s.refused ?? 0, sort: (s) => s.refused },
  { id: "unknown", title: "Unknown", text: (s) => s.unknown ?? 0, sort: (s) => s.unknown },
  { id: "detail", title: "Detail", text: (s) => s.detail ?? "", hide: true, long: true },
];

/** The tables of agents, targets, threats and sources, in their places. */
export class Tables {
  constructor(onChoose) {
    this.agents = new Table("Agents", AGENT_COLUMNS, (item) => onChoose("agent", item));
    this.targets = new Table("Targets", TARGET_COLUMNS, (item) => onChoose("target", item));
    this.threats = new Table("Threats", THREAT_COLUMNS, (item) => onChoose("threat", item));
    this.sources = new Table("Sources", SOURCE_COLUMNS, (item) => onChoose("source", item));
  }

  show(state, chosen, filter) {
    const of = (kind) => (chosen?.kind === kind ? chosen.id : null);
    this.agents.show([...state.agents.values()].filter(agentFilter(filter)), of("agent"));
    this.targets.show([...state.targets.values()], of("target"));
    this.threats.show([...state.threats.values()], of("threat"));
    const sources = (state.picture.sources ?? []).map((source) => ({ ...source, id: source.name, key: source.name }));
    this.sources.show(sources, of("source"));
  }
}

/** Agents whose id, target, state or source holds each word of a filter; a whole number means that id or target. */
function agentFilter({ text, state }) {
  const wanted = text.toLowerCase().split(/\s+/).filter(Boolean);
  return (agent) => {
    if (state === "ghost" ? !isGhost(agent) : state && agent.state !== state) return false;
    const said = `${stateWords(agent)} ${sourceWords(agent)} ${agent.certificate ?? ""}`.toLowerCase();
    const fits = (word) =>
      /^\d+$/.test(word) ? String(agent.id) === word || String(agent.target) === word : said.includes(word);
    return wanted.every(fits);
  };
}

/** Things that sources see and the mission does not have, each with a button to take it in. */
export class UnknownList {
  constructor(list, empty, onTakeIn) {
    this.list = list;
    this.empty = empty;
    this.onTakeIn = onTakeIn;
    this.rows = new Map();
  }

  show(unknown, mayAct) {
    this.empty.hidden = unknown.length > 0;
    const seen = new Set();
    for (const thing of unknown) {
      const key = `${thing.source}:${thing.kind}:${thing.id}`;
      seen.add(key);
      const row = this.rows.get(key) ?? this.newRow(key);
      row.thing = thing;
      setText(row.what, `${thing.kind} ${thing.id} from ${thing.source}`);
      const where = position(thing.north_m, thing.east_m);
      setText(row.where, `${where}, ${seconds(thing.age_s)} ago, seen ${thing.count} times`);
      row.button.hidden = !mayAct;
    }
    for (const [key, row] of this.rows) {
      if (seen.has(key)) continue;
      row.element.remove();
      this.rows.delete(key);
    }
  }

  newRow(key) {
    const row = { thing: null, what: el("strong"), where: el("span") };
    row.button = el("button", { type: "button", onclick: () => this.onTakeIn(row.thing) }, "Take in…");
    row.element = el("li", {}, el("span", { class: "what" }, row.what, el("br"), row.where), row.button);
    this.rows.set(key, row);
    this.list.append(row.element);
    return row;
  }
}

/** Rows of a description list, kept and filled again. */
export class Facts {
  constructor(list) {
    this.list = list;
    this.rows = new Map();
  }

  show(facts) {
    let before = null;
    for (const [name, value] of facts) {
      const row = this.rows.get(name) ?? this.newRow(name);
      setText(row, value);
      inOrder(this.list, row.parentElement, before);
      before = row.parentElement;
    }
    const wanted = new Set(facts.map(([name]) => name));
    for (const [name, row] of this.rows) {
      if (wanted.has(name)) continue;
      row.parentElement.remove();
      this.rows.delete(name);
    }
  }

  newRow(name) {
    const row = el("dd");
    el("div", {}, el("dt", {}, name), row);
    this.rows.set(name, row);
    return row;
  }
}

function authenticationWords(picture) {
  const kind = picture.broadcast?.authentication;
  if (kind === "unsigned") return "UNSIGNED: anybody can speak in its name";
  return { ed25519: "signed (Ed25519)", mavlink: "signed (MAVLink)", both: "signed (both ways)" }[kind] ?? NONE;
}

function broadcastFacts(picture) {
  const { broadcast } = picture;
  const budget = broadcast.budget_bytes_per_s;
  const rateWords = `${rate(broadcast.bytes_per_s, "B/s")}${budget ? ` of ${rate(budget, "B/s")}` : ", no budget set"}`;
  return [
    ["Signatures", authenticationWords(picture)],
    ["Rate", rateWords],
    ["Last frame", `${seconds(broadcast.last_frame_age_s)} ago`],
    ["Sent", `${broadcast.frames} frames, ${bytes(broadcast.bytes)}`],
    ["Link", broadcast.link ?? NONE],
    ["Epoch, revision", `${picture.epoch_s}, ${picture.revision}`],
  ];
}

/** The panel of the broadcast: rate against budget as a bar, and what each item was sent and how long ago. */
export class BroadcastPanel {
  constructor(places) {
    this.meter = places.meter;
    this.facts = new Facts(places.facts);
    this.items = new Table(
      "Refresh by item",
      [
        { id: "id", title: "Item", text: (i) => i.name },
        { id: "period", title: "Every", text: (i) => seconds(i.period_s), sort: (i) => i.period_s },
        { id: "age", title: "Sent", text: (i) => `${seconds(i.age_s)} ago`, sort: (i) => i.age_s },
      ],
      () => {},
    );
    places.items.append(this.items.element);
  }

  show(picture) {
    if (picture.broadcast?.bytes_per_s === undefined) return;
    const { bytes_per_s: now, budget_bytes_per_s: budget, items } = picture.broadcast;
    this.meter.hidden = !budget;
    if (budget) {
      this.meter.max = budget;
      this.meter.high = 0.9 * budget;
      this.meter.value = Math.min(now, budget);
      setText(this.meter, percent(now / budget));
    }
    this.facts.show(broadcastFacts(picture));
    this.items.show((items ?? []).map((item) => ({ ...item, id: item.name })), null);
  }
}

/** The line under the map. */
export function stripWords(picture) {
  const { broadcast } = picture;
  if (broadcast?.bytes_per_s === undefined) return "";
  const budget = broadcast.budget_bytes_per_s ? ` of ${rate(broadcast.budget_bytes_per_s, "B/s")}` : "";
  const now = rate(broadcast.bytes_per_s, "B/s");
  return `Broadcast ${now}${budget}, last frame ${seconds(broadcast.last_frame_age_s)} ago`;
}

/** What is known of one thing, for the panel of the chosen one. */
export function detailFacts(kind, item, plane) {
  const [lat, lon] = plane.toGlobal(item.north_m, item.east_m);
  const place = [
    ["Position", position(item.north_m, item.east_m)],
    ["Latitude, longitude", `${lat.toFixed(6)}, ${lon.toFixed(6)}`],
  ];
  if (kind === "agent") return [...agentFacts(item), ...place];
  const facts = [
    ["Speed", `${rate(speedOf(item), "m/s")}, at most ${rate(item.speed_bound_m_s, "m/s")}`],
    ["Seen", `${seconds(item.age_s)} ago, by ${item.source ?? NONE}`],
  ];
  if (kind === "target") {
    return [["Agents", ids(item.agents)], ["Reached by", ids(item.reached_by)], ...facts, ...place];
  }
  const floor = item.floor_m ?? null;
  const ceiling = item.ceiling_m ?? null;
  const height = floor === null && ceiling === null ? "all" : `${metres(floor)} to ${metres(ceiling)}`;
  const radii = [["Attack / detection", radiiWords(item)], ["Grown by age", metres(item.growth_m)]];
  return [...radii, ["Heights", height], ...facts, ...place];
}

function agentFacts(agent) {
  const { ellipse } = agent;
  const facts = [
    ["State", stateWords(agent)],
    ["Target", agent.target === null ? NONE : `${agent.target}${agent.pinned !== null ? " (pinned)" : ""}`],
    ["Arrives in", agent.eta_s === null ? NONE : seconds(agent.eta_s)],
    ["Position is", `${sourceWords(agent)}, ${seconds(agent.age_s)} old`],
  ];
  if (ellipse) {
    facts.push(["May be off by", `${metres(ellipse.semi_major_m)} along, ${metres(ellipse.semi_minor_m)} across`]);
  }
  facts.push(["Speed", `${rate(agent.speed_m_s, "m/s")}, heading ${anyValue("heading_deg", agent.heading_deg)}`]);
  facts.push(["Range left", metres(agent.range_left_m)], ["Link", linkWords(agent)]);
  if (agent.reason) facts.unshift(["Decides", agent.reason]);
  if (agent.certificate) facts.push(["Certificate", agent.certificate]);
  if (agent.said) facts.push(["Said", agent.said]);
  return facts;
}

/** The answer to "why?": its sentences, and behind them every value that it has, in words, with its unit. */
export function whyWords(answer) {
  const { sentences, as_of: asOf, ...values } = answer;
  return el(
    "div",
    {},
    el("ul", { class: "sentences" }, sentences.map((sentence) => el("li", {}, sentence))),
    el("p", { class: "quiet" }, `This is ${asOf}.`),
    el("details", {}, el("summary", {}, "All values"), valueList(values)),
  );
}

function valueList(values) {
  const row = ([key, value]) => el("div", {}, el("dt", {}, words(key)), el("dd", {}, anyValue(key, value)));
  return el("dl", { class: "facts" }, Object.entries(values).map(row));
}
