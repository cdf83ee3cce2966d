// What the page knows, made of the messages of the stream alone: a reload asks for the same and finds the same.

import { Plane } from "./geo.js";

const TRAIL_POINTS = 240; // of each agent
const TRAIL_STEP_S = 2; // at least this long between two points of a trail
const EVENTS_KEPT = 2000;
const KINDS = ["agents", "targets", "threats"];

/** The state before the first message. */
export function nothing() {
  return {
    picture: null,
    plane: null,
    agents: new Map(),
    targets: new Map(),
    threats: new Map(),
    trails: new Map(),
    routes: new Map(),
    events: [],
    timeline: [],
    playback: null,
    nowS: 0,
  };
}

/** Puts a message of the stream into the state; answers its type, or null where it changed nothing. */
export function take(state, message) {
  const taker = TAKERS[message.type];
  if (!taker || (!state.picture && message.type === "moves")) return null;
  taker(state, message);
  return message.type;
}

const TAKERS = {
  picture: takePicture,
  moves: takeMoves,
  routes: takeRoutes,
  event: takeEvent,
  playback: takePlayback,
  timeline: takeTimeline,
};

function takePicture(state, picture) {
  const before = state.picture;
  const other = before && (before.mission !== picture.mission || before.epoch_s !== picture.epoch_s);
  if (other || (before && picture.t_s < state.nowS - TRAIL_STEP_S)) state.trails.clear();
  if (before && before.mission !== picture.mission) state.events = [];
  state.picture = picture;
  const { lat_deg: latDeg, lon_deg: lonDeg } = picture.origin;
  if (!state.plane || state.plane.latDeg !== latDeg || state.plane.lonDeg !== lonDeg) {
    state.plane = new Plane(latDeg, lonDeg);
    state.trails.clear();
  }
  for (const kind of KINDS) {
    state[kind] = new Map((picture[kind] ?? []).map((item) => [String(item.id), item]));
  }
  state.nowS = picture.t_s;
  leaveTrails(state);
}

function takeMoves(state, moves) {
  state.nowS = moves.t_s;
  for (const [id, north, east, heading, speed, age] of moves.agents ?? []) {
    move(state.agents, id, { north_m: north, east_m: east, heading_deg: heading, speed_m_s: speed, age_s: age });
  }
  for (const [id, north, east, vn, ve, age] of moves.targets ?? []) {
    const velocity = { velocity_north_m_s: vn, velocity_east_m_s: ve };
    move(state.targets, id, { north_m: north, east_m: east, ...velocity, age_s: age });
  }
  for (const [id, north, east, vn, ve, age, growth] of moves.threats ?? []) {
    const velocity = { velocity_north_m_s: vn, velocity_east_m_s: ve };
    move(state.threats, id, { north_m: north, east_m: east, ...velocity, age_s: age, growth_m: growth });
  }
  leaveTrails(state);
}

function move(things, id, change) {
  const item = things.get(String(id));
  if (item) Object.assign(item, change);
}

function takeRoutes(state, message) {
  const drawn = (points) => points.map(([north, east]) => state.plane.toSquare(north, east));
  state.routes = new Map(Object.entries(message.routes ?? {}).map(([id, points]) => [id, drawn(points)]));
}

function takeEvent(state, message) {
  addEvents(state, [message.event]);
}

/** Adds events in the order of their numbers, each once. */
export function addEvents(state, events) {
  const known = new Set(state.events.map((event) => event.number));
  const fresh = events.filter((event) => !known.has(event.number));
  if (!fresh.length) return;
  state.events = [...state.events, ...fresh].sort((one, other) => one.number - other.number).slice(-EVENTS_KEPT);
}

/** A run that was wound back has not seen yet what came later. */
function takePlayback(state, message) {
  if (state.playback && message.at_s < state.playback.at_s) {
    state.events = state.events.filter((event) => event.unix_s <= message.at_s + 1);
  }
  state.playback = message;
}

/** All events of a recorded run, also those that are still to come. */
function takeTimeline(state, message) {
  state.timeline = message.events;
}

function leaveTrails(state) {
  for (const [id, agent] of state.agents) {
    const trail = state.trails.get(id) ?? [];
    const last = trail[trail.length - 1];
    if (last && state.nowS - last.t < TRAIL_STEP_S) continue;
    trail.push({ t: state.nowS, at: state.plane.toSquare(agent.north_m, agent.east_m) });
    if (trail.length > TRAIL_POINTS) trail.splice(0, trail.length - TRAIL_POINTS);
    state.trails.set(id, trail);
  }
}

/** Takes the trails that the server kept: {agent id: [[t_s, north_m, east_m], ...]}. */
export function takeTrails(state, trails) {
  for (const [id, points] of Object.entries(trails)) {
    const old = points.map(([t, north, east]) => ({ t, at: state.plane.toSquare(north, east) }));
    const since = state.trails.get(id) ?? [];
    const until = since.length ? since[0].t : Infinity;
    state.trails.set(id, [...old.filter((point) => point.t < until), ...since].slice(-TRAIL_POINTS));
  }
}

/** Whether an agent's place is reckoned, not told by itself or a sensor: the ghost. */
export function isGhost(agent) {
  return agent.source === "reckoned" || agent.source === "mission";
}

const SOURCES = {
  telemetry: "telemetry",
  sensor: "sensor",
  report: "report",
  reckoned: "reckoned",
  mission: "mission file",
  truth: "as it was",
};

/** Who says where an agent is, in words. */
export function sourceWords(agent) {
  return SOURCES[agent.source] ?? String(agent.source);
}

/** What the broadcast's signatures are, and whether there are none. */
export function isUnsigned(picture) {
  return picture.broadcast?.authentication === "unsigned";
}
