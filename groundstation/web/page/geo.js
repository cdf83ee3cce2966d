// The mission's plane (azimuthal equidistant about the origin, as companion/geo/local_frame.py has it), WGS84 and the
// square of Web Mercator that Leaflet and its tiles use. Everything is drawn by way of these, so that a circle of the
// plan stands where the vehicles reckon it. tests/web compares them with Python's numbers.

const A_M = 6378137.0; // WGS84, semi-major axis in m
const F = 1 / 298.257223563; // WGS84, flattening
const B_M = A_M * (1 - F);
const RAD = Math.PI / 180;
const TURNS = 100; // of the iterations below, which end after about five for distances of a mission
const ENOUGH_RAD = 1e-13; // less than a micrometre on the Earth

/** Series of Vincenty (1975) that both ways share, for the squared cosine of the azimuth at the equator. */
function series(cosSquaredAlpha) {
  const u = (cosSquaredAlpha * (A_M * A_M - B_M * B_M)) / (B_M * B_M);
  return {
    big: 1 + (u / 16384) * (4096 + u * (-768 + u * (320 - 175 * u))),
    small: (u / 1024) * (256 + u * (-128 + u * (74 - 47 * u))),
    c: (F / 16) * cosSquaredAlpha * (4 + F * (4 - 3 * cosSquaredAlpha)),
  };
}

function deltaSigma(small, sinSigma, cosSigma, cos2m) {
  const inner = cosSigma * (2 * cos2m * cos2m - 1);
  const outer = (small / 6) * cos2m * (4 * sinSigma * sinSigma - 3) * (4 * cos2m * cos2m - 3);
  return small * sinSigma * (cos2m + (small / 4) * (inner - outer));
}

function lonDifference(c, sinAlpha, sigma, sinSigma, cosSigma, cos2m) {
  return (1 - c) * F * sinAlpha * (sigma + c * sinSigma * (cos2m + c * cosSigma * (2 * cos2m * cos2m - 1)));
}

/** The projection about an origin in degrees. */
export class Plane {
  constructor(latDeg, lonDeg) {
    this.latDeg = latDeg;
    this.lonDeg = lonDeg;
    this.u = Math.atan((1 - F) * Math.tan(latDeg * RAD)); // reduced latitude
  }

  /** [lat, lon] in degrees of a place in metres; the longitude is not wrapped, for maps across the date line. */
  toGlobal(northM, eastM) {
    const distanceM = Math.hypot(northM, eastM);
    if (distanceM === 0) return [this.latDeg, this.lonDeg];
    const azimuth = Math.atan2(eastM, northM);
    const sinU = Math.sin(this.u);
    const cosU = Math.cos(this.u);
    const cosAzimuth = Math.cos(azimuth);
    const sinAlpha = cosU * Math.sin(azimuth);
    const sigma1 = Math.atan2(sinU, cosU * cosAzimuth);
    const { big, small, c } = series(1 - sinAlpha * sinAlpha);
    let sigma = distanceM / (B_M * big);
    let cos2m = 0;
    for (let turn = 0; turn < TURNS; turn += 1) {
      cos2m = Math.cos(2 * sigma1 + sigma);
      const next = distanceM / (B_M * big) + deltaSigma(small, Math.sin(sigma), Math.cos(sigma), cos2m);
      const step = Math.abs(next - sigma);
      sigma = next;
      if (step < ENOUGH_RAD) break;
    }
    const sinSigma = Math.sin(sigma);
    const cosSigma = Math.cos(sigma);
    const x = sinU * sinSigma - cosU * cosSigma * cosAzimuth;
    const lat = Math.atan2(sinU * cosSigma + cosU * sinSigma * cosAzimuth, (1 - F) * Math.hypot(sinAlpha, x));
    const lambda = Math.atan2(sinSigma * Math.sin(azimuth), cosU * cosSigma - sinU * sinSigma * cosAzimuth);
    const lon = lambda - lonDifference(c, sinAlpha, sigma, sinSigma, cosSigma, cos2m);
    return [lat / RAD, this.lonDeg + lon / RAD];
  }

  /** [north, east] in metres of a place in degrees; NaN where the series does not end, on the Earth's other side. */
  toLocal(latDeg, lonDeg) {
    const difference = wrapped((lonDeg - this.lonDeg) * RAD);
    const u2 = Math.atan((1 - F) * Math.tan(latDeg * RAD));
    const [sin1, cos1, sin2, cos2] = [Math.sin(this.u), Math.cos(this.u), Math.sin(u2), Math.cos(u2)];
    let lambda = difference;
    for (let turn = 0; turn < TURNS; turn += 1) {
      const across = cos2 * Math.sin(lambda);
      const along = cos1 * sin2 - sin1 * cos2 * Math.cos(lambda);
      const sinSigma = Math.hypot(across, along);
      if (sinSigma === 0) return [0, 0];
      const cosSigma = sin1 * sin2 + cos1 * cos2 * Math.cos(lambda);
      const sigma = Math.atan2(sinSigma, cosSigma);
      const sinAlpha = (cos1 * cos2 * Math.sin(lambda)) / sinSigma;
      const cosSquared = 1 - sinAlpha * sinAlpha;
      const cos2m = cosSquared === 0 ? 0 : cosSigma - (2 * sin1 * sin2) / cosSquared;
      const { big, small, c } = series(cosSquared);
      const next = difference + lonDifference(c, sinAlpha, sigma, sinSigma, cosSigma, cos2m);
      const step = Math.abs(next - lambda);
      lambda = next;
      if (step < ENOUGH_RAD) {
        const distanceM = B_M * big * (sigma - deltaSigma(small, sinSigma, cosSigma, cos2m));
        const azimuth = Math.atan2(across, along);
        return [distanceM * Math.cos(azimuth), distanceM * Math.sin(azimuth)];
      }
    }
    return [NaN, NaN];
  }

  /** [x, y] of a place in metres in the square of Web Mercator, from 0 to 1, y down: what pixels are a multiple of. */
  toSquare(northM, eastM) {
    const [latDeg, lonDeg] = this.toGlobal(northM, eastM);
    return toSquare(latDeg, lonDeg);
  }
}

/** [x, y] of degrees in the square of Web Mercator, from 0 to 1, y down. */
export function toSquare(latDeg, lonDeg) {
  const sine = Math.sin(latDeg * RAD);
  return [(lonDeg + 180) / 360, 0.5 - Math.log((1 + sine) / (1 - sine)) / (4 * Math.PI)];
}

function wrapped(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}
