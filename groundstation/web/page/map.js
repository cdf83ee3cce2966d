// The map: Leaflet for panning, zooming and tiles, and one canvas above it for everything that moves.
//
// Leaflet's own square of Mercator is kept, rather than a plane in metres, so that tiles of any source lie under the
// mission; each place goes through the mission's projection first (geo.js), so nothing is drawn beside where it is
// flown.

import { draw, paletteOf } from "./draw.js";

const L = window.L;
const TILE_PX = 256;
const REACH_PX = 18; // how near a click counts as on a mark
const MOST_ZOOM = 23;
const MOST_TILE_ZOOM = 19; // of the usual tile sets; nearer, their tiles are enlarged
const PADDING = { paddingTopLeft: [24, 56], paddingBottomRight: [24, 32] }; // below the buttons, above the scale
const DRAG_PX = 6; // a press that moves less is a click

export class MissionMap {
  /** A map in an element; `actions` are called with what was chosen, picked and dragged. */
  constructor(element, state, actions) {
    this.element = element;
    this.state = state;
    this.actions = actions;
    const layers = { trails: true, assignments: true, routes: true, hatch: true };
    this.ui = { chosen: null, moving: null, layers, palette: null };
    this.marks = [];
    this.due = false;
    this.fitted = null;
    this.picking = null;
    this.frameMs = [];
    this.leaflet = makeLeaflet(element);
    this.canvas = makeCanvas(element);
    this.listen();
    this.readPalette();
  }

  listen() {
    this.leaflet.on("move zoom resize viewreset", () => this.request());
    this.leaflet.on("click", (event) => this.clicked(event.containerPoint, event.latlng));
    this.leaflet.on("mousemove", (event) => this.pointed(event));
    this.element.addEventListener("pointerdown", (event) => this.pressed(event), true);
    this.element.addEventListener("keydown", (event) => this.keyed(event));
    new ResizeObserver(() => this.resized()).observe(this.element);
  }

  readPalette() {
    this.ui.palette = paletteOf(this.element);
    this.request();
  }

  /** A hidden map keeps its place; one that shrinks keeps what is chosen in sight. */
  resized() {
    if (!this.element.clientWidth || !this.element.clientHeight) return;
    this.leaflet.invalidateSize();
    const item = this.actions.chosenItem();
    if (item) this.show(item.north_m, item.east_m);
    if (this.fitted !== this.state.picture?.mission) this.fit();
    this.request();
  }

  choose(chosen) {
    this.ui.chosen = chosen;
    this.request();
  }

  /** Draws at the next frame of the screen, once, however often it is asked. */
  request() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => this.drawNow());
  }

  drawNow() {
    this.due = false;
    const began = performance.now();
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    if (this.fitted !== this.state.picture?.mission) this.fit();
    const corner = this.leaflet.getPixelBounds().min;
    const scale = TILE_PX * 2 ** this.leaflet.getZoom();
    const view = { width, height, ratio, scale, left: corner.x, top: corner.y };
    this.marks = draw(this.canvas.getContext("2d"), view, this.state, this.ui);
    this.frameMs.push(performance.now() - began);
    if (this.frameMs.length > 300) this.frameMs.shift();
  }

  /** Shows all of the mission. */
  fit() {
    const { picture, plane } = this.state;
    if (!picture || !this.element.clientWidth) return;
    const reach = (item, radius) => [
      [item.north_m - radius, item.east_m - radius],
      [item.north_m + radius, item.east_m + radius],
    ];
    const corners = [
      ...picture.agents.flatMap((item) => reach(item, 0)),
      ...picture.targets.flatMap((item) => reach(item, picture.arrival_radius_m ?? 0)),
      ...picture.threats.flatMap((item) => reach(item, item.detection_radius_m)),
      ...(picture.fence ?? []),
    ];
    if (!corners.length) corners.push([-500, -500], [500, 500]);
    this.fitted = picture.mission;
    const bounds = L.latLngBounds(corners.map(([n, e]) => plane.toGlobal(n, e)));
    this.leaflet.fitBounds(bounds, { ...PADDING, animate: false });
    this.request();
  }

  show(northM, eastM) {
    if (!this.element.clientWidth) return;
    const place = this.state.plane.toGlobal(northM, eastM);
    if (!this.leaflet.getBounds().pad(-0.05).contains(place)) this.leaflet.panTo(place, { animate: false });
    this.request();
  }

  /** The middle of the map. */
  centre() {
    return this.placeOf(this.leaflet.getCenter());
  }

  placeOf(latLng) {
    const [northM, eastM] = this.state.plane.toLocal(latLng.lat, latLng.lng);
    return { north_m: northM, east_m: eastM };
  }

  /** Waits for a place on the map: a click, or Enter for its middle. Escape gives up. */
  pick(radiiM, done) {
    this.picking = { radiiM, done };
    this.element.classList.add("picking");
    this.ui.moving = { ...this.centre(), radiiM };
    this.element.focus({ preventScroll: true });
    this.request();
  }

  endPick(place) {
    const { picking } = this;
    this.picking = null;
    this.ui.moving = null;
    this.element.classList.remove("picking");
    this.request();
    picking?.done(place);
  }

  nearest(point) {
    let best = null;
    for (const mark of this.marks) {
      const away = Math.hypot(mark.x - point.x, mark.y - point.y);
      if (away <= REACH_PX && (best === null || away <= best.away)) best = { ...mark, away };
    }
    return best;
  }

  clicked(point, latLng) {
    if (!this.state.plane) return;
    if (this.picking) this.endPick(this.placeOf(latLng));
    else if (!this.dragged) this.actions.choose(this.nearest(point));
    this.dragged = false;
  }

  pointed(event) {
    if (!this.state.plane) return;
    if (this.picking) {
      this.ui.moving = { ...this.placeOf(event.latlng), radiiM: this.picking.radiiM };
      this.request();
    }
    const over = !this.picking && this.nearest(event.containerPoint) !== null;
    this.element.classList.toggle("pointing", over);
    this.actions.point(this.placeOf(event.latlng), event.latlng);
  }

  keyed(event) {
    if (!this.picking) return;
    if (event.key === "Enter") {
      this.endPick(this.centre());
      event.preventDefault();
    } else if (event.key === "Escape") {
      this.endPick(null);
    } else if (event.key.startsWith("Arrow")) {
      requestAnimationFrame(() => {
        if (!this.picking) return;
        this.ui.moving = { ...this.centre(), radiiM: this.picking.radiiM };
        this.request();
      });
    }
  }

  /** A press on the chosen target or threat begins to drag it, if the operator may. */
  pressed(event) {
    if (this.picking || event.button !== 0 || !this.state.plane) return;
    const box = this.element.getBoundingClientRect();
    const mark = this.nearest({ x: event.clientX - box.left, y: event.clientY - box.top });
    const { chosen } = this.ui;
    if (!mark || !chosen || mark.kind !== chosen.kind || String(mark.id) !== String(chosen.id)) return;
    const radiiM = this.actions.dragRadii(mark);
    if (radiiM === null) return;
    event.stopPropagation();
    this.drag(event, mark, radiiM);
  }

  drag(press, mark, radiiM) {
    const box = this.element.getBoundingClientRect();
    this.leaflet.dragging.disable();
    this.element.setPointerCapture(press.pointerId);
    const at = (event) => {
      const point = L.point(event.clientX - box.left, event.clientY - box.top);
      return this.placeOf(this.leaflet.containerPointToLatLng(point));
    };
    const moved = (event) => Math.hypot(event.clientX - press.clientX, event.clientY - press.clientY) > DRAG_PX;
    const onMove = (event) => {
      if (!moved(event) && !this.ui.moving) return;
      this.ui.moving = { ...at(event), radiiM };
      this.request();
    };
    const onEnd = (event) => {
      this.element.removeEventListener("pointermove", onMove);
      this.element.removeEventListener("pointerup", onEnd);
      this.element.removeEventListener("pointercancel", onEnd);
      this.leaflet.dragging.enable();
      const went = this.ui.moving !== null && event.type === "pointerup";
      this.ui.moving = null;
      this.request();
      if (!went) return;
      this.dragged = true;
      setTimeout(() => (this.dragged = false), 0);
      this.actions.moved(mark, at(event));
    };
    this.element.addEventListener("pointermove", onMove);
    this.element.addEventListener("pointerup", onEnd);
    this.element.addEventListener("pointercancel", onEnd);
  }

  /** Lays the tiles that the ground station serves under the mission. */
  layTiles() {
    L.tileLayer("/tiles/{z}/{x}/{y}.png", { maxNativeZoom: MOST_TILE_ZOOM, maxZoom: MOST_ZOOM }).addTo(this.leaflet);
  }
}

function makeLeaflet(element) {
  const map = L.map(element, {
    zoomAnimation: false,
    fadeAnimation: false,
    markerZoomAnimation: false,
    inertia: false,
    zoomSnap: 0.25,
    zoomDelta: 0.5,
    maxZoom: MOST_ZOOM,
    minZoom: 2,
    boxZoom: false,
    doubleClickZoom: false,
    attributionControl: true,
    worldCopyJump: false,
  });
  map.attributionControl.setPrefix(false);
  map.setView([0, 0], 2, { animate: false });
  L.control.scale({ imperial: false, maxWidth: 140 }).addTo(map);
  element.tabIndex = 0;
  return map;
}

function makeCanvas(element) {
  const canvas = document.createElement("canvas");
  canvas.className = "mission-canvas";
  canvas.setAttribute("aria-hidden", "true");
  element.append(canvas);
  return canvas;
}
