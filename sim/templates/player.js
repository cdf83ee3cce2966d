"use strict";
// Plays a flight on a canvas. Everything is in metres, north up; the data stand in the page (sim/player.py).
(() => {
  const flight = JSON.parse(document.getElementById("flight").textContent);
  const element = (id) => document.getElementById(id);
  const canvas = element("player-map"), slider = element("player-time"), button = element("player-play");
  const speed = element("player-speed"), view = element("player-view"), clock = element("player-clock");
  const words = element("player-words");
  const times = summed(flight.t_ds).map((ds) => ds / 10);
  const end = times[times.length - 1];
  const kinds = ["agents", "targets", "threats"];
  for (const kind of kinds) {
    for (const thing of flight[kind]) {
      thing.track = [thing.n, thing.e].map((steps) => summed(steps).map((value) => value * flight.unit_m));
    }
  }
  const EDGE = 22;  // Room for labels at the edge, CSS pixels.
  let now = 0, playing = false, last = null, scale = 1;

  function summed(steps) {
    let sum = 0;
    return steps.map((step) => (sum += step));
  }

  // Index of the last of the rising values that is at most `value`, at least 0.
  function before(values, value) {
    let low = 0, high = values.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (values[middle] <= value) low = middle; else high = middle - 1;
    }
    return low;
  }

  function place(thing, t) {
    const at = before(times, t), next = Math.min(at + 1, times.length - 1);
    const share = next > at ? Math.min(Math.max((t - times[at]) / (times[next] - times[at]), 0), 1) : 0;
    return thing.track.map((values) => values[at] + share * (values[next] - values[at]));
  }

  // Whether a thing that was added or retired in flight is there at a time.
  function isThere(thing, t) {
    const at = before(times, t);
    let there = thing.there.length === 0;
    for (let edge = 0; edge < thing.there.length && thing.there[edge] <= at; edge++) there = edge % 2 === 0;
    return there;
  }

  // Time of the picture that is known at a time: by one agent, or the newest that any has; null before the first.
  function pictureTime(t) {
    const chosen = view.value === "" ? flight.agents : flight.agents.filter((agent) => String(agent.id) === view.value);
    let newest = null;
    for (const agent of chosen) {
      const heard = agent.heard;
      if (heard.length === 0 || heard[0][0] > t) continue;
      const of = heard[before(heard.map((pair) => pair[0]), t)][1];
      if (newest === null || of > newest) newest = of;
    }
    return newest;
  }

  function fit() {
    const width = canvas.clientWidth, height = Math.round(Math.min(width * 0.8, window.innerHeight * 0.75));
    const dense = window.devicePixelRatio || 1;
    canvas.style.height = height + "px";
    canvas.width = width * dense;
    canvas.height = height * dense;
    const [south, west, north, east] = flight.box;
    scale = Math.min((width - 2 * EDGE) / (east - west), (height - 2 * EDGE) / (north - south));
    const pen = canvas.getContext("2d");
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    const left = (width - scale * (east - west)) / 2, top = (height - scale * (north - south)) / 2;
    return { pen, width, height, x: (e) => left + scale * (e - west), y: (n) => top + scale * (north - n) };
  }

  function draw() {
    const map = fit(), { pen, x, y } = map;
    const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(name).trim();
    const text = colour("--text"), page = colour("--page");
    pen.fillStyle = page;
    pen.fillRect(0, 0, map.width, map.height);
    pen.font = "bold 13px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const circle = (at, radius, stroke, dash, fill) => {
      pen.beginPath();
      pen.arc(x(at[1]), y(at[0]), Math.max(radius * scale, 1), 0, 2 * Math.PI);
      if (fill) { pen.fillStyle = fill; pen.fill(); }
      pen.setLineDash(dash);
      pen.strokeStyle = stroke;
      pen.stroke();
      pen.setLineDash([]);
    };
    const polygon = (corners, stroke, fill) => {
      pen.beginPath();
      for (const corner of corners) pen.lineTo(x(corner[1]), y(corner[0]));
      pen.closePath();
      if (fill) { pen.fillStyle = fill; pen.fill(); }
      pen.strokeStyle = stroke;
      pen.stroke();
    };
    const label = (at, words, up, ink) => {
      pen.lineWidth = 3;
      pen.strokeStyle = page;
      pen.strokeText(words, x(at[1]), y(at[0]) - up);
      pen.fillStyle = ink;
      pen.fillText(words, x(at[1]), y(at[0]) - up);
      pen.lineWidth = 1.5;
    };
    pen.lineWidth = 1.5;
    if (flight.fence) polygon(flight.fence, colour("--fence"), null);
    for (const area of flight.exclusions) polygon(area, colour("--attack"), colour("--shade"));
    const known = pictureTime(now);
    for (const threat of flight.threats.filter((one) => isThere(one, now))) {
      const at = place(threat, now);
      circle(at, threat.detection, colour("--detection"), [], colour("--shade"));
      circle(at, threat.attack, colour("--attack"), [], null);
      if (known !== null && threat.bound > 0) {
        circle(place(threat, known), threat.detection + threat.bound * (now - known), colour("--detection"), [5, 4], null);
      }
      label(at, "!" + threat.id, threat.detection * scale < 16 ? threat.detection * scale + 9 : 0, text);
    }
    for (const target of flight.targets.filter((one) => isThere(one, now))) {
      const at = place(target, now), isReached = target.reached !== null && now >= target.reached;
      circle(at, flight.arrival, colour("--target"), isReached ? [] : [2, 3], null);
      pen.beginPath();
      pen.moveTo(x(at[1]) - 6, y(at[0]));
      pen.lineTo(x(at[1]) + 6, y(at[0]));
      pen.moveTo(x(at[1]), y(at[0]) - 6);
      pen.lineTo(x(at[1]), y(at[0]) + 6);
      pen.strokeStyle = colour("--target");
      pen.lineWidth = 2.5;
      pen.stroke();
      label(at, (isReached ? "\u2713 " : "") + "T" + target.id, -15, colour("--target"));
    }
    for (const agent of flight.agents) {
      const chosen = String(agent.id) === view.value;
      pen.beginPath();
      const until = before(times, now);
      for (let at = 0; at <= until; at++) pen.lineTo(x(agent.track[1][at]), y(agent.track[0][at]));
      const [north, east] = place(agent, now);
      pen.lineTo(x(east), y(north));
      pen.strokeStyle = colour(chosen ? "--agent" : "--trail");
      pen.lineWidth = chosen ? 2.5 : 1.2;
      pen.stroke();
      const [aheadN, aheadE] = place(agent, now + 1), [behindN, behindE] = place(agent, now - 1);
      const course = Math.atan2(aheadE - behindE, aheadN - behindN);
      pen.save();
      pen.translate(x(east), y(north));
      pen.rotate(course);
      pen.beginPath();
      for (const [right, up] of [[0, -9], [6, 7], [0, 4], [-6, 7]]) pen.lineTo(right, up);
      pen.closePath();
      pen.fillStyle = agent.lost !== null && now >= agent.lost ? colour("--trail") : colour("--agent");
      pen.fill();
      pen.restore();
      if (flight.agents.length <= 60 || chosen) label([north, east], String(agent.id), 15, text);
    }
    tell(known);
  }

  function tell(known) {
    slider.value = String(now);
    const at = now.toFixed(now < 100 ? 1 : 0) + " s";
    slider.setAttribute("aria-valuetext", at);
    clock.textContent = at + " of " + end.toFixed(0) + " s";
    const agent = flight.agents.find((one) => String(one.id) === view.value);
    const age = known === null ? "no picture heard yet" : "newest picture is " + (now - known).toFixed(1) + " s old";
    let said = "";
    if (agent) {
      const decided = agent.words.filter((pair) => pair[0] <= now);
      said = "Agent " + agent.id + ": " + (decided.length ? decided[decided.length - 1][1] : "nothing decided yet") + "; ";
    }
    words.textContent = said + age + ".";
  }

  function step(stamp) {
    if (!playing) return;
    if (last !== null) now = Math.min(now + Number(speed.value) * Math.min(stamp - last, 250) / 1000, end);
    last = stamp;
    if (now >= end) play(false);
    draw();
    if (playing) requestAnimationFrame(step);
  }

  function play(on) {
    if (on && now >= end) now = 0;
    playing = on;
    last = null;
    button.textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame(step);
  }

  function seek(t) {
    now = Math.min(Math.max(t, 0), end);
    draw();
  }

  function faster(by) {
    const index = speed.selectedIndex + by;
    if (index >= 0 && index < speed.options.length) speed.selectedIndex = index;
  }

  const keys = {
    " ": () => play(!playing), ArrowLeft: () => seek(now - end / 100), ArrowRight: () => seek(now + end / 100),
    Home: () => seek(0), End: () => seek(end), "+": () => faster(1), "-": () => faster(-1),
  };
  element("player").addEventListener("keydown", (event) => {
    if (!(event.key in keys) || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.target.tagName === "SELECT" || (event.target === button && event.key === " ")) return;
    event.preventDefault();
    keys[event.key]();
  });
  for (const agent of flight.agents) view.add(new Option("Agent " + agent.id, String(agent.id)));
  for (const factor of [1, 2, 5, 10, 20, 50, 100, 200]) speed.add(new Option(factor + "\u00d7", String(factor)));
  // About half a minute for the whole flight.
  speed.value = [...speed.options].map((option) => option.value).find((factor) => end / factor <= 40) || "200";
  slider.max = String(end);
  slider.step = "0.1";
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  view.addEventListener("change", draw);
  window.addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  element("player").hidden = false;
  draw();
})();
