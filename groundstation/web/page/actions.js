// What an operator can do. Each is asked once more in the dialog, given as a command, and can be taken back from the
// time line where the ground station allows it. Nothing here knows whether a vehicle obeyed: none of them can answer.

import { command } from "./api.js";
import { choice, confirmed, field } from "./dialog.js";
import { el } from "./dom.js";
import { position, thing } from "./format.js";

const ONE_WAY = "Vehicles follow at the next broadcast that they hear; none of them can confirm it.";
const DIRECTIVES = {
  hold: { title: "Hold", all: "hold: each loiters where it hears this", one: "holds: it loiters where it hears this" },
  return: { title: "Recall", all: "return: each flies back and loiters there", one: "flies back and loiters there" },
  normal: { title: "Back to normal", all: "go on to their targets", one: "goes on to its target" },
};
const ALONE = "Those that were held or recalled alone go on, too.";
const PLACE_DECIMALS = { metres: 1, degrees: 7 };

export class Actions {
  /** Actions on a page: `page` has state, map, warn() and told(). */
  constructor(page) {
    this.page = page;
  }

  /** Gives a command and says what became of it. */
  async give(body, words) {
    const event = await command(body);
    this.page.told(words, event);
    return event;
  }

  ask(question) {
    const text = Array.isArray(question.text) ? question.text : [question.text];
    confirmed({ ...question, text: [...text, this.page.staleWarning()] });
  }

  /** Tells one agent what to do, or all of them where `agent` is left out. */
  direct(directive, agent = null) {
    const { title, all, one } = DIRECTIVES[directive];
    const count = this.page.state.agents.size;
    const whom = agent ? `agent ${agent.id}` : "all agents";
    this.ask({
      title: `${title}: ${whom}`,
      text: [
        agent ? `Agent ${agent.id} ${one}.` : `All ${count} agents ${all}.`,
        !agent && directive === "normal" ? ALONE : "",
        ONE_WAY,
      ],
      confirm: `${title} ${agent ? whom : `all ${count}`}`,
      danger: directive === "return",
      act: () => this.give({ do: "direct", directive, agent: agent?.id ?? null }, `${title}: ${whom}`),
    });
  }

  pause(paused) {
    this.ask({
      title: paused ? "Resume the mission" : "Pause the mission",
      text: paused
        ? "Agents go on, with the assignments they had."
        : ["All agents hold and the assignment is frozen until the mission is resumed.", ONE_WAY],
      confirm: paused ? "Resume" : "Pause",
      act: () => this.give({ do: paused ? "resume" : "pause" }, paused ? "Mission resumed" : "Mission paused"),
    });
  }

  takeOut(agent) {
    this.ask({
      title: `Take agent ${agent.id} out`,
      text: [
        `Agent ${agent.id} gets no target any more; its target goes to another agent if one can reach it.`,
        ONE_WAY,
      ],
      confirm: `Take agent ${agent.id} out`,
      danger: true,
      act: () => this.give({ do: "take-out", agent: agent.id }, `Agent ${agent.id} taken out`),
    });
  }

  putBack(agent) {
    this.ask({
      title: `Put agent ${agent.id} back`,
      text: `Agent ${agent.id} takes part in the assignment again.`,
      confirm: `Put agent ${agent.id} back`,
      act: () => this.give({ do: "put-back", agent: agent.id }, `Agent ${agent.id} put back`),
    });
  }

  pin(agent) {
    const targets = [...this.page.state.targets.values()].map((target) => [String(target.id), thing("target", target)]);
    const options = [["", "as the assignment says"], ...targets];
    this.ask({
      title: `Pin agent ${agent.id} to a target`,
      text: `A pinned agent goes to its target whatever the assignment says.`,
      fields: [choice("target", "Target", options, String(agent.pinned ?? agent.target ?? ""))],
      confirm: "Pin",
      act: (form) => {
        const target = form.get("target") === "" ? null : Number(form.get("target"));
        const words = target === null ? `Agent ${agent.id} unpinned` : `Agent ${agent.id} pinned to target ${target}`;
        return this.give({ do: "pin", agent: agent.id, target }, words);
      },
    });
  }

  retire(kind, item) {
    const effect = kind === "threat" ? "Vehicles will fly through where it is." : "Nobody is sent there any more.";
    this.ask({
      title: `Retire ${thing(kind, item)}`,
      text: [`The ${kind} leaves the picture for good. ${effect}`, ONE_WAY],
      confirm: `Retire ${kind} ${item.id}`,
      danger: true,
      act: () => this.give({ do: "retire", kind, id: item.id }, `${thing(kind, item)} retired`),
    });
  }

  undo(event, words) {
    this.ask({
      title: `Undo event ${event.number}`,
      text: `Takes back: ${words}`,
      confirm: "Undo",
      act: () => this.give({ do: "undo", number: event.number }, `Undone: ${words}`),
    });
  }

  /** A form for a new target or threat; `known` are values that it begins with. */
  add(kind, known = {}) {
    this.ask({
      title: `Add a ${kind}`,
      text: kind === "threat" ? "Vehicles that hear of it bend their ways around it." : "",
      fields: this.fieldsOf(kind, known),
      confirm: `Add ${kind}`,
      act: (form) => {
        const body = { do: `add-${kind}`, ...placeOf(form), ...numbersOf(form, kind) };
        if (known.id !== undefined) body.id = known.id;
        if (form.get("name").trim()) body.name = form.get("name").trim();
        return this.give(body, `${kind} added`);
      },
    });
  }

  /** Place, radii, bound and name of a target or threat. */
  change(kind, item) {
    this.ask({
      title: `Change ${thing(kind, item)}`,
      text: "",
      fields: this.fieldsOf(kind, item),
      confirm: "Change",
      act: (form) => {
        const body = { do: "change", kind, id: item.id, ...changed(form, kind, item) };
        return this.give(body, `${thing(kind, item)} changed`);
      },
    });
  }

  /** A target or threat to another place, as by dragging it. */
  move(kind, item, place) {
    this.ask({
      title: `Move ${thing(kind, item)}`,
      text: [`From ${position(item.north_m, item.east_m)}`, `to ${position(place.north_m, place.east_m)}.`, ONE_WAY],
      confirm: "Move",
      act: () => {
        const to = { north_m: rounded(place.north_m), east_m: rounded(place.east_m) };
        return this.give({ do: "change", kind, id: item.id, ...to }, `${thing(kind, item)} moved`);
      },
    });
  }

  /** What a sensor calls a threat keeps its number, so that the sensor moves it; a strange vehicle becomes a threat. */
  takeIn(unknown) {
    const place = { north_m: unknown.north_m, east_m: unknown.east_m };
    if (unknown.kind === "agent") this.add("threat", place);
    else this.add(unknown.kind, { ...place, id: unknown.id });
  }

  /** The fields of a target or threat; `known` are values that they begin with. */
  fieldsOf(kind, known) {
    return [
      ...this.placeFields(known),
      field("name", "Name", { maxlength: "40", value: known.name ?? "" }, "optional"),
      ...(kind === "threat" ? threatFields(known) : []),
      number("speed_bound_m_s", "Speed bound in m/s", known.speed_bound_m_s ?? 0, "the fastest that it may move"),
    ];
  }

  /** The fields of a place, in metres or degrees; the other form follows what is typed. */
  placeFields(known) {
    const { plane } = this.page.state;
    const { north_m: north, east_m: east } = known.north_m === undefined ? this.page.map.centre() : known;
    const [lat, lon] = plane.toGlobal(north, east);
    const fields = {
      metres: [
        place("north_m", "North in m", north.toFixed(PLACE_DECIMALS.metres)),
        place("east_m", "East in m", east.toFixed(PLACE_DECIMALS.metres)),
      ],
      degrees: [
        place("lat_deg", "Latitude in °", lat.toFixed(PLACE_DECIMALS.degrees)),
        place("lon_deg", "Longitude in °", lon.toFixed(PLACE_DECIMALS.degrees)),
      ],
    };
    const groups = Object.entries(fields).map(([name, inner]) =>
      el("div", { class: "pair", "data-unit": name, hidden: name !== "metres" }, inner),
    );
    const unit = (name, words) => {
      const radio = el("input", { type: "radio", name: "unit", value: name, checked: name === "metres" });
      radio.addEventListener("change", () => groups.forEach((group) => (group.hidden = group.dataset.unit !== name)));
      return el("label", { class: "radio" }, radio, words);
    };
    const legend = el("legend", {}, "Place");
    return [
      el(
        "fieldset",
        {},
        legend,
        el("div", { class: "row" }, unit("metres", "metres"), unit("degrees", "lat/lon")),
        groups,
      ),
    ];
  }
}

const rounded = (value) => Math.round(value * 100) / 100;
const place = (name, label, value) => field(name, label, { inputmode: "decimal", value, required: true });

function number(name, label, value, hint) {
  return field(name, label, { inputmode: "decimal", value: String(value ?? "") }, hint);
}

function threatFields(known) {
  return [
    number("attack_radius_m", "Attack radius in m", known.attack_radius_m ?? 500, "the inner disc, kept out of first"),
    number("detection_radius_m", "Detection radius in m", known.detection_radius_m ?? 1000, "vehicles keep out of it"),
    el(
      "div",
      { class: "pair" },
      number("floor_m", "Floor in m", known.floor_m, "empty: from the ground"),
      number("ceiling_m", "Ceiling in m", known.ceiling_m, "empty: without end"),
    ),
  ];
}

/** The number in a field; raises an Error with the field's name. */
function numberIn(form, name) {
  const text = String(form.get(name) ?? "").trim().replace(",", ".");
  const value = Number(text);
  if (text === "" || !Number.isFinite(value)) throw new Error(`${name}: '${text}' is not a number`);
  return value;
}

function placeOf(form) {
  const names = form.get("unit") === "degrees" ? ["lat_deg", "lon_deg"] : ["north_m", "east_m"];
  return Object.fromEntries(names.map((name) => [name, numberIn(form, name)]));
}

function numbersOf(form, kind) {
  const names = kind === "threat" ? ["attack_radius_m", "detection_radius_m", "speed_bound_m_s"] : ["speed_bound_m_s"];
  const values = Object.fromEntries(names.map((name) => [name, numberIn(form, name)]));
  for (const name of kind === "threat" ? ["floor_m", "ceiling_m"] : []) {
    if (String(form.get(name)).trim() !== "") values[name] = numberIn(form, name);
  }
  return values;
}

/** Only what was changed: the rest stays as the ground station has it meanwhile. */
function changed(form, kind, item) {
  const values = { ...placeOf(form), ...numbersOf(form, kind) };
  const same = Object.keys(values).filter((name) => Math.abs(values[name] - (item[name] ?? NaN)) < 0.06);
  const stays = !("lat_deg" in values) && same.includes("north_m") && same.includes("east_m");
  for (const name of same) if (name !== "north_m" && name !== "east_m") delete values[name];
  if (stays) {
    delete values.north_m;
    delete values.east_m;
  }
  if (form.get("name").trim() !== (item.name ?? "")) values.name = form.get("name").trim();
  if (!Object.keys(values).length) throw new Error("nothing was changed");
  return values;
}

/** Radii that are shown while a thing is dragged. */
export function radiiOf(kind, item) {
  return kind === "threat" ? [item.detection_radius_m, item.attack_radius_m] : [];
}
