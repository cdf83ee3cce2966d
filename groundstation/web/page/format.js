// Numbers and words as people read them, with their units.

export const NONE = "–";

const finite = (value) => typeof value === "number" && Number.isFinite(value);

export function metres(value) {
  if (!finite(value)) return NONE;
  const size = Math.abs(value);
  if (size >= 100000) return `${(value / 1000).toFixed(0)} km`;
  if (size >= 10000) return `${(value / 1000).toFixed(1)} km`;
  return `${value.toFixed(size < 10 ? 1 : 0)} m`;
}

export function seconds(value) {
  if (!finite(value)) return NONE;
  if (value < 10) return `${value.toFixed(1)} s`;
  if (value < 120) return `${value.toFixed(0)} s`;
  return clock(value);
}

/** Hours, minutes and seconds, as 0:12:05. */
export function clock(value) {
  if (!finite(value)) return NONE;
  const whole = Math.floor(Math.abs(value));
  const two = (number) => String(number).padStart(2, "0");
  return `${value < 0 ? "−" : ""}${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

export function dayTime(unixS) {
  return finite(unixS) ? new Date(unixS * 1000).toISOString().slice(11, 19) : NONE;
}

export function rate(value, unit) {
  return finite(value) ? `${value.toFixed(value < 10 ? 1 : 0)} ${unit}` : NONE;
}

export function percent(share) {
  return finite(share) ? `${(share * 100).toFixed(share < 0.1 ? 1 : 0)} %` : NONE;
}

export function position(northM, eastM) {
  return finite(northM) && finite(eastM) ? `${northM.toFixed(0)} m N, ${eastM.toFixed(0)} m E` : NONE;
}

export function latLon(latDeg, lonDeg) {
  return `${latDeg.toFixed(6)}, ${lonDeg.toFixed(6)}`;
}

export function bytes(value) {
  if (!finite(value)) return NONE;
  return value < 10000 ? `${value.toFixed(0)} B` : `${(value / 1000).toFixed(0)} kB`;
}

/** "target 3 (Bridge)" for a thing with a name, "target 3" for one without. */
export function thing(kind, item) {
  return item.name ? `${kind} ${item.id} (${item.name})` : `${kind} ${item.id}`;
}

const UNITS = [
  [/_m_s$/, (value) => rate(value, "m/s")],
  [/_deg_s$/, (value) => rate(value, "°/s")],
  [/_m$/, metres],
  [/_s$/, seconds],
  [/_deg$/, (value) => (finite(value) ? `${value.toFixed(1)}°` : NONE)],
  [/_hz$/, (value) => rate(value, "Hz")],
];

/** A key of the interface as words, without its unit: north_m is "north". */
export function words(key) {
  return key.replace(/_(m_s|deg_s|m|s|deg|hz)$/, "").replace(/[_-]/g, " ");
}

/** Any value of the interface as text, in the unit that its key names. */
export function anyValue(key, value) {
  if (value === null || value === undefined) return NONE;
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") {
    const unit = UNITS.find(([pattern]) => pattern.test(key));
    if (unit) return unit[1](value);
    return Number.isInteger(value) ? String(value) : value.toPrecision(4);
  }
  if (Array.isArray(value)) return value.length ? value.map((each) => anyValue(key, each)).join(", ") : "none";
  if (typeof value === "object") {
    const parts = Object.entries(value).map(([inner, part]) => `${words(inner)} ${anyValue(inner, part)}`);
    return parts.join(", ");
  }
  return String(value);
}
