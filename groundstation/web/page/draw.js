// One picture of the mission on one canvas: what is drawn tells itself apart by shape as well as by colour.
//
// agent, seen or told   filled arrow             target         square with its number, dotted arrival circle
// agent, reckoned       hollow arrow in its      threat         hatched attack disc, dashed detection circle,
//                       dashed ellipse                          dotted rim as far as age has let it grow
// agent, lost or out    crossed circle           unknown        diamond with a question mark

import { isGhost } from "./model.js";

const ARROW_PX = 11;
const HALO_PX = 3;
const LABELS_AT_MOST = 120; // names on the map at one time
const MARK_PX = 8; // half the side of a sign, which no name covers
const LABEL_CHARACTERS = 22;
const SQUARE_PX = 7;
const HATCH_PX = 9;
const HATCH_SCALE = 2; // pixels of the tile for each of the screen's
const RAD = Math.PI / 180;
const MANY = 100; // agents, from which on their lines are drawn without dashes, which cost more than all else
const AHEAD_M = 10; // how far ahead a heading is projected to find its direction on the map
const places = new WeakMap();
const arrows = new Map();
const hatches = new Map();
const widths = new Map(); // of labels in pixels
const MOST_WIDTHS = 5000;

const SIGNS = ["agent", "ghost", "gone", "target", "threat", "unknown"];
const COLOURS = [...SIGNS, "route", "trail", "fence", "ink", "halo", "chosen"];

/** The colours of the theme, read from the style sheet once after each change of theme. */
export function paletteOf(element) {
  const style = getComputedStyle(element);
  const palette = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--map-${name}`).trim()]));
  palette.font = `600 12px ${style.getPropertyValue("--font").trim() || "sans-serif"}`;
  return palette;
}

/** The place of a thing in Mercator's square, reckoned once for each of its positions. */
function squareOf(plane, item) {
  const known = places.get(item);
  if (known && known.n === item.north_m && known.e === item.east_m && known.plane === plane) return known.at;
  const at = plane.toSquare(item.north_m, item.east_m);
  places.set(item, { n: item.north_m, e: item.east_m, plane, at });
  return at;
}

/** Draws the mission's picture; answers the marks that can be pointed at, the last drawn last. */
export function draw(context, view, state, ui) {
  const { palette } = ui;
  const scene = { context, view, state, ui, palette, marks: [], labels: [], many: state.agents.size > MANY };
  context.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
  context.clearRect(0, 0, view.width, view.height);
  if (!state.picture) return scene.marks;
  context.lineJoin = "round";
  context.font = palette.font;
  drawArea(scene);
  drawTrails(scene);
  for (const threat of state.threats.values()) drawThreat(scene, threat);
  drawAssignments(scene);
  drawRoutes(scene);
  for (const target of state.targets.values()) drawTarget(scene, target);
  for (const thing of state.picture.unknown ?? []) drawUnknown(scene, thing);
  for (const agent of state.agents.values()) if (isGhost(agent)) drawEllipse(scene, agent);
  for (const agent of state.agents.values()) drawAgent(scene, agent);
  drawLabels(scene);
  drawMoving(scene);
  return scene.marks;
}

const pixel = (view, [x, y]) => [x * view.scale - view.left, y * view.scale - view.top];
const within = (value, end, margin) => value > -margin && value < end + margin;
const inside = (view, x, y, margin) => within(x, view.width, margin) && within(y, view.height, margin);
const isChosen = (ui, kind, id) => ui.chosen !== null && ui.chosen.kind === kind && String(ui.chosen.id) === String(id);

/** Half axes in pixels of a circle in metres about a place of the plane. */
function radiiPx(scene, item, radiusM) {
  const { plane } = scene.state;
  const [x, y] = pixel(scene.view, squareOf(plane, item));
  const [nx, ny] = pixel(scene.view, plane.toSquare(item.north_m + radiusM, item.east_m));
  const [ex, ey] = pixel(scene.view, plane.toSquare(item.north_m, item.east_m + radiusM));
  return { x, y, rx: Math.hypot(ex - x, ey - y), ry: Math.hypot(nx - x, ny - y) };
}

function circle(scene, item, radiusM) {
  const { x, y, rx, ry } = radiiPx(scene, item, radiusM);
  scene.context.beginPath();
  scene.context.ellipse(x, y, rx, ry, 0, 0, 2 * Math.PI);
  return { x, y, rx, ry };
}

function line(scene, points, closed) {
  scene.context.beginPath();
  trace(scene, points);
  if (closed) scene.context.closePath();
}

/** Adds a line to the present path: many lines are drawn at once far faster than one after the other. */
function trace(scene, points) {
  points.forEach((at, index) => {
    const [x, y] = pixel(scene.view, at);
    if (index) scene.context.lineTo(x, y);
    else scene.context.moveTo(x, y);
  });
}

function stroke(scene, colour, width, dash = []) {
  scene.context.strokeStyle = colour;
  scene.context.lineWidth = width;
  scene.context.setLineDash(dash);
  scene.context.stroke();
  scene.context.setLineDash([]);
}

function drawArea(scene) {
  const { picture, plane } = scene.state;
  const polygon = (corners) => corners.map(([n, e]) => plane.toSquare(n, e));
  if (picture.fence) {
    line(scene, polygon(picture.fence), true);
    stroke(scene, scene.palette.fence, 2, [10, 4, 2, 4]);
  }
  for (const exclusion of picture.exclusions ?? []) {
    line(scene, polygon(exclusion), true);
    hatch(scene, scene.palette.fence);
    stroke(scene, scene.palette.fence, 2);
  }
}

/** Fills the present path with slanted lines, which stay where they are on the map. */
function hatch(scene, colour) {
  const { context, view } = scene;
  const pattern = hatchOf(context, colour);
  pattern.setTransform(new DOMMatrix().translate(-view.left % HATCH_PX, -view.top % HATCH_PX).scale(1 / HATCH_SCALE));
  context.fillStyle = pattern;
  context.globalAlpha = 0.4;
  context.fill();
  context.globalAlpha = 1;
}

/** A tile of slanted lines in a colour, made once: filled far faster than lines that are clipped. */
function hatchOf(context, colour) {
  if (!hatches.has(colour)) {
    const tile = document.createElement("canvas");
    const side = HATCH_PX * HATCH_SCALE;
    tile.width = tile.height = side;
    const ink = tile.getContext("2d");
    ink.strokeStyle = colour;
    ink.lineWidth = HATCH_SCALE;
    ink.beginPath();
    for (const at of [-side, 0, side]) {
      ink.moveTo(at, side);
      ink.lineTo(at + side, 0);
    }
    ink.stroke();
    hatches.set(colour, context.createPattern(tile, "repeat"));
  }
  return hatches.get(colour);
}

function drawTrails(scene) {
  if (!scene.ui.layers.trails) return;
  scene.context.beginPath();
  for (const [id, trail] of scene.state.trails) {
    if (trail.length > 1 && scene.state.agents.has(id)) trace(scene, trail.map((point) => point.at));
  }
  stroke(scene, scene.palette.trail, 1.5);
}

function drawThreat(scene, threat) {
  const { context, palette, ui, view } = scene;
  const outer = Math.max(threat.detection_radius_m, threat.attack_radius_m) + Math.max(threat.growth_m ?? 0, 0);
  const rim = circle(scene, threat, outer);
  if (!inside(view, rim.x, rim.y, Math.max(rim.rx, rim.ry))) return;
  context.globalAlpha = 0.1;
  context.fillStyle = palette.threat;
  context.fill();
  context.globalAlpha = 1;
  if (threat.growth_m > 0) stroke(scene, palette.threat, 1, [2, 3]);
  circle(scene, threat, threat.detection_radius_m);
  stroke(scene, palette.threat, 1.5, [7, 4]);
  circle(scene, threat, threat.attack_radius_m);
  if (ui.layers.hatch) hatch(scene, palette.threat);
  stroke(scene, palette.threat, 2);
  arrowOfVelocity(scene, threat, palette.threat);
  badge(scene, "threat", threat, rim, palette.threat);
}

function drawTarget(scene, target) {
  const { palette, state, view } = scene;
  const rim = circle(scene, target, state.picture.arrival_radius_m ?? 0);
  if (!inside(view, rim.x, rim.y, Math.max(rim.rx, rim.ry, 40))) return;
  if (rim.rx > 4) stroke(scene, palette.target, 1.5, [2, 3]);
  arrowOfVelocity(scene, target, palette.target);
  badge(scene, "target", target, rim, palette.target);
}

/** A square (target) or a triangle (threat) in the middle of a thing, its number beside it. */
function badge(scene, kind, item, { x, y }, colour) {
  const { context, palette, ui } = scene;
  context.beginPath();
  if (kind === "target") {
    context.rect(x - SQUARE_PX, y - SQUARE_PX, 2 * SQUARE_PX, 2 * SQUARE_PX);
  } else {
    context.moveTo(x, y - SQUARE_PX - 2);
    context.lineTo(x + SQUARE_PX + 2, y + SQUARE_PX);
    context.lineTo(x - SQUARE_PX - 2, y + SQUARE_PX);
    context.closePath();
  }
  stroke(scene, palette.halo, 2 + HALO_PX);
  context.fillStyle = kind === "target" && item.reached_by?.length ? palette.halo : colour;
  context.fill();
  stroke(scene, colour, 2);
  if (isChosen(ui, kind, item.id)) ring(scene, x, y);
  if (kind === "target" && item.reached_by?.length) tick(scene, x, y, colour);
  scene.marks.push({ kind, id: item.id, x, y });
  const text = labelOf(item, kind === "target" ? "T" : "!");
  scene.labels.push({ x, y, text, colour, chosen: isChosen(ui, kind, item.id) });
}

function tick(scene, x, y, colour) {
  const { context } = scene;
  context.beginPath();
  context.moveTo(x - 4, y);
  context.lineTo(x - 1, y + 3.5);
  context.lineTo(x + 4.5, y - 4);
  stroke(scene, colour, 2);
}

function labelOf(item, sign) {
  const text = item.name ? `${sign}${item.id} ${item.name}` : `${sign}${item.id}`;
  return text.length > LABEL_CHARACTERS ? `${text.slice(0, LABEL_CHARACTERS - 1)}…` : text;
}

function arrowOfVelocity(scene, item, colour) {
  const speed = Math.hypot(item.velocity_north_m_s ?? 0, item.velocity_east_m_s ?? 0);
  if (!(speed > 0.05)) return;
  const { plane } = scene.state;
  const [x, y] = pixel(scene.view, squareOf(plane, item));
  const step = AHEAD_M / speed;
  const [north, east] = [item.velocity_north_m_s * step, item.velocity_east_m_s * step];
  const ahead = plane.toSquare(item.north_m + north, item.east_m + east);
  const [ax, ay] = pixel(scene.view, ahead);
  const angle = Math.atan2(ay - y, ax - x);
  const reach = 24;
  scene.context.beginPath();
  scene.context.moveTo(x, y);
  scene.context.lineTo(x + reach * Math.cos(angle), y + reach * Math.sin(angle));
  for (const turn of [2.6, -2.6]) {
    scene.context.moveTo(x + reach * Math.cos(angle), y + reach * Math.sin(angle));
    scene.context.lineTo(
      x + reach * Math.cos(angle) + 6 * Math.cos(angle + turn),
      y + reach * Math.sin(angle) + 6 * Math.sin(angle + turn),
    );
  }
  stroke(scene, colour, 1.5);
}

function drawAssignments(scene) {
  if (!scene.ui.layers.assignments) return;
  const { state, palette, view } = scene;
  scene.context.beginPath();
  for (const agent of state.agents.values()) {
    const target = agent.target === null ? null : state.targets.get(String(agent.target));
    if (!target || agent.state !== "under way") continue;
    if (scene.many && scene.ui.layers.routes && state.routes.has(String(agent.id))) continue; // its route says the same
    scene.context.moveTo(...pixel(view, squareOf(state.plane, agent)));
    scene.context.lineTo(...pixel(view, squareOf(state.plane, target)));
  }
  scene.context.globalAlpha = scene.many ? 0.25 : 0.7;
  stroke(scene, palette.ink, 1, scene.many ? [] : [1, 5]);
  scene.context.globalAlpha = 1;
}

function drawRoutes(scene) {
  const { context, state, palette, ui } = scene;
  if (!ui.layers.routes) return;
  const chosen = ui.chosen?.kind === "agent" ? state.routes.get(String(ui.chosen.id)) : undefined;
  context.beginPath();
  for (const [id, points] of state.routes) if (points !== chosen && state.agents.has(id)) trace(scene, points);
  context.globalAlpha = chosen ? 0.45 : 1;
  stroke(scene, palette.route, scene.many ? 1 : 1.8);
  context.globalAlpha = 1;
  if (!chosen) return;
  line(scene, chosen);
  stroke(scene, palette.halo, 6);
  stroke(scene, palette.route, 3);
}

function drawUnknown(scene, thing) {
  const { context, palette, state, view } = scene;
  if (thing.north_m === null || thing.north_m === undefined) return;
  const [x, y] = pixel(view, squareOf(state.plane, thing));
  if (!inside(view, x, y, 20)) return;
  context.beginPath();
  context.moveTo(x, y - 10);
  context.lineTo(x + 10, y);
  context.lineTo(x, y + 10);
  context.lineTo(x - 10, y);
  context.closePath();
  context.fillStyle = palette.halo;
  context.fill();
  stroke(scene, palette.unknown, 2);
  context.fillStyle = palette.unknown;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText("?", x, y + 0.5);
  scene.marks.push({ kind: "unknown", id: `${thing.source}:${thing.kind}:${thing.id}`, x, y });
}

function drawEllipse(scene, agent) {
  const { ellipse } = agent;
  if (!ellipse) return;
  const { context, palette, view } = scene;
  const { x, y, rx } = radiiPx(scene, agent, 1000);
  const [major, minor] = [(ellipse.semi_major_m * rx) / 1000, (ellipse.semi_minor_m * rx) / 1000];
  if (!inside(view, x, y, major)) return;
  const slant = directionPx(scene, agent, ellipse.heading_deg ?? 0);
  context.beginPath();
  context.ellipse(x, y, Math.max(major, 1), Math.max(minor, 1), slant, 0, 2 * Math.PI);
  context.fillStyle = palette.ghost;
  context.globalAlpha = 0.12;
  context.fill();
  context.globalAlpha = 1;
  stroke(scene, palette.ghost, scene.many ? 1 : 1.5, scene.many ? [] : [4, 3]);
}

/** The angle on the screen of a heading in the plane at a thing's place. */
function directionPx(scene, item, headingDeg) {
  const { plane } = scene.state;
  const [x, y] = squareOf(plane, item);
  const [north, east] = [Math.cos(headingDeg * RAD), Math.sin(headingDeg * RAD)];
  const [ax, ay] = plane.toSquare(item.north_m + AHEAD_M * north, item.east_m + AHEAD_M * east);
  return Math.atan2(ay - y, ax - x);
}

function drawAgent(scene, agent) {
  const { context, palette, state, ui, view } = scene;
  const [x, y] = pixel(view, squareOf(state.plane, agent));
  if (!inside(view, x, y, 30)) return;
  const gone = agent.state === "lost" || agent.state === "out";
  const ghost = isGhost(agent);
  const colour = gone ? palette.gone : ghost ? palette.ghost : palette.agent;
  const chosen = isChosen(ui, "agent", agent.id);
  if (chosen) ring(scene, x, y);
  const look = { hollow: ghost || gone, dotted: agent.source === "telemetry" && !gone };
  const sign = arrowOf(view.ratio, colour, palette.halo, look);
  const half = ARROW_PX + HALO_PX;
  context.save();
  context.translate(x, y);
  context.rotate(directionPx(scene, agent, agent.heading_deg ?? 0));
  context.drawImage(sign, -half, -half, 2 * half, 2 * half);
  context.restore();
  if (gone) cross(scene, x, y, colour);
  scene.marks.push({ kind: "agent", id: agent.id, x, y });
  scene.labels.push({ x, y, text: agentLabel(agent, ghost), colour: chosen ? palette.ink : colour, chosen });
}

function agentLabel(agent, ghost) {
  const age = ghost && agent.age_s >= 1 ? ` ~${Math.round(agent.age_s)} s` : "";
  const directive = agent.directive && agent.directive !== "normal" ? ` ${agent.directive}` : "";
  const end = agent.state === "arrived" ? " ✓" : "";
  return `${agent.id}${end}${directive}${age}`;
}

function ring(scene, x, y) {
  scene.context.beginPath();
  scene.context.arc(x, y, 17, 0, 2 * Math.PI);
  stroke(scene, scene.palette.halo, 5);
  stroke(scene, scene.palette.chosen, 2.5);
}

function cross(scene, x, y, colour) {
  const { context } = scene;
  context.beginPath();
  context.arc(x, y, 10, 0, 2 * Math.PI);
  context.moveTo(x - 7, y - 7);
  context.lineTo(x + 7, y + 7);
  stroke(scene, colour, 2);
}

/** An agent's arrow, made once for each look: hundreds of them are drawn five times a second. */
function arrowOf(ratio, colour, halo, { hollow, dotted }) {
  const key = [ratio, colour, halo, hollow, dotted].join();
  if (arrows.has(key)) return arrows.get(key);
  const half = ARROW_PX + HALO_PX;
  const sign = document.createElement("canvas");
  sign.width = sign.height = Math.ceil(2 * half * ratio);
  const ink = sign.getContext("2d");
  ink.setTransform(ratio, 0, 0, ratio, half * ratio, half * ratio);
  ink.lineJoin = "round";
  ink.beginPath();
  ink.moveTo(ARROW_PX, 0);
  ink.lineTo(-ARROW_PX * 0.75, ARROW_PX * 0.7);
  ink.lineTo(-ARROW_PX * 0.35, 0);
  ink.lineTo(-ARROW_PX * 0.75, -ARROW_PX * 0.7);
  ink.closePath();
  ink.strokeStyle = halo;
  ink.lineWidth = 2 + HALO_PX;
  ink.stroke();
  ink.fillStyle = hollow ? halo : colour;
  ink.fill();
  ink.strokeStyle = colour;
  ink.lineWidth = 2;
  ink.stroke();
  if (dotted) {
    ink.beginPath();
    ink.arc(0, 0, 2.4, 0, 2 * Math.PI);
    ink.fillStyle = halo;
    ink.fill();
  }
  arrows.set(key, sign);
  return sign;
}

/** Names beside their things, the chosen one first; one that would cover another or a sign is left out. */
function drawLabels(scene) {
  const { context, palette, view } = scene;
  const around = (x, y) => ({ left: x - MARK_PX, right: x + MARK_PX, top: y - MARK_PX, bottom: y + MARK_PX });
  const taken = scene.marks.map(({ x, y }) => around(x, y));
  let named = 0;
  const sorted = [...scene.labels.filter((label) => label.chosen), ...scene.labels.filter((label) => !label.chosen)];
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const { x, y, text, colour } of sorted) {
    if (named >= LABELS_AT_MOST) break;
    if (!inside(view, x, y, 0)) continue;
    const width = widthOf(context, text);
    const [right, other] = [x + 14, x - 14 - width];
    const sides = right + width > view.width ? [other, right] : [right, other];
    const left = sides.find((side) => !taken.some((box) => covers(box, side, y, width)));
    if (left === undefined) continue;
    taken.push({ left, right: left + width, top: y - 8, bottom: y + 8 });
    named += 1;
    context.strokeStyle = palette.halo;
    context.lineWidth = HALO_PX;
    context.strokeText(text, left, y);
    context.fillStyle = colour;
    context.fillText(text, left, y);
  }
}

function widthOf(context, text) {
  if (widths.size > MOST_WIDTHS) widths.clear();
  if (!widths.has(text)) widths.set(text, context.measureText(text).width);
  return widths.get(text);
}

function covers(box, left, y, width) {
  return left < box.right && left + width > box.left && y - 8 < box.bottom && y + 8 > box.top;
}

/** What is being placed or dragged: a cross where it would stand, with its circles. */
function drawMoving(scene) {
  const { moving } = scene.ui;
  if (!moving) return;
  const { context, palette } = scene;
  for (const radiusM of moving.radiiM ?? []) {
    circle(scene, moving, radiusM);
    stroke(scene, palette.chosen, 2, [6, 4]);
  }
  const [x, y] = pixel(scene.view, squareOf(scene.state.plane, moving));
  context.beginPath();
  context.moveTo(x - 14, y);
  context.lineTo(x + 14, y);
  context.moveTo(x, y - 14);
  context.lineTo(x, y + 14);
  stroke(scene, palette.halo, 5);
  stroke(scene, palette.chosen, 2);
}
