// The time line: every accepted fact with its time and who did it, and a way back where there is one.

import { el } from "./dom.js";
import { anyValue, words } from "./format.js";

const SHOWN = 300; // events in the list, the newest first
const named = (kind, id, name) => (name ? `${kind} ${id} (${name})` : `${kind} ${id}`);
const everyone = (agent) => (agent === null || agent === undefined ? "all agents" : `agent ${agent}`);
const goes = ({ agent, target }) => `agent ${agent} ${target === null ? "has no target" : `to target ${target}`}`;

/** Who was given which target, by the reasons. */
function assigned(changes) {
  const byReason = new Map();
  for (const change of changes) byReason.set(change.reason, [...(byReason.get(change.reason) ?? []), goes(change)]);
  return [...byReason].map(([reason, all]) => all.join(", ") + (reason ? `: ${reason}` : "")).join("; ");
}

const SENTENCES = {
  "target-added": (e) => `${named("target", e.target.id, e.name)} added`,
  "threat-added": (e) => `${named("threat", e.threat.id, e.name)} added`,
  "target-changed": (e) => `${named("target", e.target.id, e.name)} ${e.moved ? "moved" : "changed"}`,
  "threat-changed": (e) => `${named("threat", e.threat.id, e.name)} ${e.moved ? "moved" : "changed"}`,
  retired: (e) => `${e.kind} ${e.id} retired${e.reason ? ` (${e.reason})` : ""}`,
  pinned: (e) => (e.target === null ? `agent ${e.agent} unpinned` : `agent ${e.agent} pinned to target ${e.target}`),
  "taken-out": (e) => `agent ${e.agent} taken out`,
  "put-back": (e) => `agent ${e.agent} put back`,
  directed: (e) => `${everyone(e.agent)}: ${e.directive}`,
  paused: () => "mission paused",
  resumed: () => "mission resumed",
  arrived: (e) => `agent ${e.agent} arrived at target ${e.target}`,
  "arrival-taken-back": (e) => `agent ${e.agent} was not at target ${e.target} after all`,
  lost: (e) => `agent ${e.agent} counts as lost`,
  "heard-again": (e) => `agent ${e.agent} heard again`,
  assigned: (e) => assigned(e.changes),
  "revision-began": (e) => `revision ${e.revision} is broadcast, ${e.threats} threat${e.threats === 1 ? "" : "s"}`,
  started: (e) => `ground station started with ${e.mission}`,
  stopped: (e) => `ground station stopped${e.reason ? `: ${e.reason}` : ""}`,
  "track-began": (e) => `${e.source}: ${e.key} is ${e.kind} ${e.id}`,
  "track-ended": (e) => `${e.source}: ${e.key} ended${e.reason ? ` (${e.reason})` : ""}`,
  "unknown-seen": (e) => `${e.source} sees an unknown ${e.kind} ${e.id}`,
};

/** An event in a sentence; one of a kind that the page does not know yet is told by its values. */
export function sentence(event) {
  const make = SENTENCES[event.event];
  const rest = ({ number, unix_s: time, who, event: kind, ...others }) => others;
  const text = make ? make(event) : `${words(String(event.event))}: ${anyValue("", rest(event))}`;
  return event.undoes ? `${text} (takes back ${event.undoes})` : text;
}

/** The list of events, newest first. */
export class Timeline {
  constructor(list, onUndo) {
    this.list = list;
    this.onUndo = onUndo;
    this.told = "";
  }

  /** Shows events; `undoable` are the numbers of those that who looks can take back, `when` tells their times. */
  show(events, undoable, filter, when) {
    const wanted = filter.toLowerCase();
    const told = `${undoable.join()} ${wanted} ${events.length} ${events.at(-1)?.number} ${when(0)}`;
    if (told === this.told) return;
    this.told = told;
    const fits = (event) => !wanted || `${sentence(event)} ${event.who?.name ?? ""}`.toLowerCase().includes(wanted);
    const shown = events.filter(fits).slice(-SHOWN).reverse();
    const item = (event) => this.item(event, undoable.includes(event.number), when(event.unix_s));
    this.list.replaceChildren(...shown.map(item));
  }

  item(event, undoable, when) {
    const words = sentence(event);
    const label = `Undo event ${event.number}`;
    const act = () => this.onUndo(event, words);
    const undo = undoable ? el("button", { type: "button", "aria-label": label, onclick: act }, "Undo") : null;
    return el(
      "li",
      { "data-event": event.event, class: event.who?.role === "operator" ? "by-hand" : null },
      el("span", { class: "when" }, when),
      el("span", { class: "number" }, `#${event.number}`),
      el("span", { class: "what" }, words),
      el("span", { class: "who" }, event.who?.name ?? ""),
      undo,
    );
  }
}
