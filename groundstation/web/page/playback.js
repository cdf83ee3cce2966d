// The controls of a recorded run (time, speed, from event to event) and of the simulator (speed, pause).

import { post } from "./api.js";
import { el, setText } from "./dom.js";
import { clock } from "./format.js";
import { sentence } from "./timeline.js";

const SPEEDS = [0.5, 1, 2, 5, 10, 20, 50];

export class Playback {
  /** Controls in an element; `onProblem` is told what the ground station refuses. */
  constructor(element, onProblem) {
    this.element = element;
    this.onProblem = onProblem;
    this.held = false;
    this.playing = false;
    this.speeds = "";
    this.listed = null;
    this.play = el("button", { type: "button", onclick: () => this.set({ playing: !this.playing }) }, "Pause");
    this.slider = el("input", { type: "range", min: "0", max: "1", step: "any", "aria-label": "Time of the flight" });
    this.slider.addEventListener("input", () => this.slide());
    this.slider.addEventListener("change", () => this.settle());
    this.time = el("output", { class: "time" });
    this.speed = el("select", { "aria-label": "Speed", onchange: () => this.set({ speed: Number(this.speed.value) }) });
    this.jump = el("select", { "aria-label": "Jump to an event", onchange: () => this.jumpTo() });
    element.append(this.play, this.slider, this.time, this.speed, this.jump);
  }

  async set(change) {
    try {
      await post("/playback", change);
    } catch (problem) {
      this.onProblem(problem.message);
    }
  }

  slide() {
    this.held = true;
    setText(this.time, clock(Number(this.slider.value) - this.from));
  }

  async settle() {
    await this.set({ at_s: Number(this.slider.value) });
    this.held = false;
  }

  jumpTo() {
    if (this.jump.value !== "") this.set({ at_s: Number(this.jump.value) });
    this.jump.value = "";
  }

  /** Shows where a run is; a simulator has no way back, so it has no slider. */
  show(playback, mode, mayAct) {
    this.element.hidden = !playback || mode === "live" || !mayAct;
    if (this.element.hidden) return;
    const { from_s: from, to_s: to, at_s: at, speed, playing } = playback;
    this.playing = playing;
    this.from = from;
    setText(this.play, playing ? "Pause" : "Play");
    this.slider.hidden = this.jump.hidden = mode !== "playback";
    this.slider.min = String(from);
    this.slider.max = String(to);
    if (!this.held) {
      this.slider.value = String(at);
      this.slider.setAttribute("aria-valuetext", clock(at - from));
      setText(this.time, mode === "playback" ? `${clock(at - from)} of ${clock(to - from)}` : clock(at - from));
    }
    this.showSpeeds(speed);
  }

  showSpeeds(speed) {
    const known = typeof speed === "number" && speed > 0;
    const all = [...new Set([...SPEEDS, ...(known ? [speed] : [])])].sort((one, other) => one - other);
    if (this.speeds !== all.join()) {
      this.speeds = all.join();
      this.speed.replaceChildren(...all.map((each) => el("option", { value: each }, `${each}×`)));
    }
    if (document.activeElement !== this.speed && known) this.speed.value = String(speed);
  }

  /** Lists the events of the whole run to jump to. */
  showEvents(events) {
    if (this.listed === events || this.from === undefined) return;
    this.listed = events;
    const words = (event) => `${clock(Math.max(0, event.unix_s - this.from))} ${sentence(event)}`;
    const options = events.map((event) => el("option", { value: event.unix_s }, words(event)));
    this.jump.replaceChildren(el("option", { value: "" }, "Jump to…"), ...options);
  }
}
