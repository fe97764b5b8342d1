// A map without WebGL: published tiles as images, tracks as SVG, moved by drag, wheel, keys and buttons. The same interface as map.js.

import { ask, send } from "/static/api.js";
import { ClassPixels, pixelsOf } from "/static/map/class_pixels.js";
import { roomOn } from "/static/map/room.js";
import { element } from "/static/ui/dom.js";
import { scheme, whenSchemeChanges } from "/static/ui/tones.js";

const TILE = 256;
const [LOWEST, HIGHEST] = [2, 22];
const LAYERS = { ortho: "webp", semantic: "png" };
const NOTHING = new Set();
const SVG = "http://www.w3.org/2000/svg";

// (x, y) in the unit square of Web Mercator.
const unitFrom = ([lon, lat]) => {
  const phi = (Math.max(-85.05, Math.min(85.05, lat)) * Math.PI) / 180;
  return [(lon + 180) / 360, 0.5 - Math.asinh(Math.tan(phi)) / (2 * Math.PI)];
};

const linesOf = ({ type, coordinates }) => (type === "LineString" ? [coordinates] : coordinates);

export const mountMap = (container, about) => new PlainMap(container, about);

export class PlainMap {
  constructor(container, { info, why }) {
    this.pixels = new ClassPixels(info.classes.filter((one) => one.in_map));
    this.map = null;
    this.tracks = new Map();
    this.hidden = new Set();
    this.images = new Map();
    this.version = null;
    this.chosen = null;
    this.zoom = 4;
    this.centre = unitFrom([10, 48]);
    this.view = element("div", "plain-map");
    this.view.tabIndex = 0;
    this.view.setAttribute("role", "group");
    this.view.setAttribute("aria-label", "Map: arrow keys move it, plus and minus zoom");
    this.tiles = element("div", "plain-tiles");
    this.lines = document.createElementNS(SVG, "svg");
    this.lines.setAttribute("aria-hidden", "true");
    this.view.append(this.tiles, this.lines);
    this.keys = element("p", "plain-keys");
    document.getElementById("legend")?.append(this.keys);
    container.append(this.view, this.#buttons(), element("p", "plain-note", `A plain map: ${why}. Everything else works as usual.`));
    this.#listen();
    new ResizeObserver(() => this.#draw()).observe(this.view);
    whenSchemeChanges(() => this.#recolour());
  }

  #buttons() {
    const box = element("div", "plain-buttons");
    for (const [text, name, by] of [["+", "Zoom in", 1], ["−", "Zoom out", -1]]) {
      const button = element("button", "", text);
      button.type = "button";
      button.ariaLabel = name;
      button.addEventListener("click", () => this.#zoomBy(by));
      box.append(button);
    }
    return box;
  }

  #listen() {
    let from = null;
    this.view.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      this.view.setPointerCapture(event.pointerId);
    });
    this.view.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.#moveBy(from[0] - event.clientX, from[1] - event.clientY);
      from = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) this.view.addEventListener(end, () => (from = null));
    let rolled = 0;
    this.view.addEventListener("wheel", (event) => {
      event.preventDefault();
      rolled += event.deltaY;
      if (Math.abs(rolled) < 60) return;
      this.#zoomBy(rolled > 0 ? -1 : 1);
      rolled = 0;
    }, { passive: false });
    const keys = {
      ArrowLeft: () => this.#moveBy(-80, 0), ArrowRight: () => this.#moveBy(80, 0), ArrowUp: () => this.#moveBy(0, -80),
      ArrowDown: () => this.#moveBy(0, 80), "+": () => this.#zoomBy(1), "-": () => this.#zoomBy(-1),
    };
    this.view.addEventListener("keydown", (event) => {
      if (!(event.key in keys)) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  get #world() {
    return TILE * 2 ** this.zoom;
  }

  #moveBy(dx, dy) {
    this.centre = [this.centre[0] + dx / this.#world, this.centre[1] + dy / this.#world];
    this.#draw();
  }

  #zoomBy(by) {
    this.zoom = Math.max(LOWEST, Math.min(HIGHEST, this.zoom + by));
    this.#draw();
  }

  #draw() {
    const { clientWidth: width, clientHeight: height } = this.view;
    if (!width || !height) return;
    const corner = [this.centre[0] * this.#world - width / 2, this.centre[1] * this.#world - height / 2];
    const wanted = new Map();
    for (const [name, suffix] of Object.entries(LAYERS)) this.#place(name, suffix, corner, [width, height], wanted);
    for (const [key, image] of this.images) {
      if (wanted.has(key)) continue;
      image.remove();
      this.images.delete(key);
    }
    for (const [key, spot] of wanted) this.#tile(key, spot);
    this.#drawTracks(corner, width, height);
  }

  // Notes the tiles of a layer that are in view: where, how large, and where they come from.
  #place(name, suffix, [left, top], [width, height], wanted) {
    const layer = this.version?.layers[name];
    if (!layer || this.hidden.has(name) || this.zoom < layer.min_zoom) return;
    const z = Math.min(this.zoom, layer.max_zoom);
    const size = TILE * 2 ** (this.zoom - z);
    const [west, south, east, north] = this.version.bounds ?? [-180, -85, 180, 85];
    const [x0, y0] = unitFrom([west, north]).map((one) => Math.floor(one * 2 ** z));
    const [x1, y1] = unitFrom([east, south]).map((one) => Math.floor(one * 2 ** z));
    const base = `/v1/maps/${this.version.map_id}/versions/${this.version.version}/tiles/${name}`;
    for (let x = Math.max(x0, Math.floor(left / size)); x <= Math.min(x1, Math.floor((left + width) / size)); x++) {
      for (let y = Math.max(y0, Math.floor(top / size)); y <= Math.min(y1, Math.floor((top + height) / size)); y++) {
        wanted.set(`${base}/${z}/${x}/${y}.${suffix}`, { name, size, x: x * size - left, y: y * size - top });
      }
    }
  }

  #tile(address, { name, size, x, y }) {
    let image = this.images.get(address);
    if (!image) {
      image = element("img", name);
      image.alt = "";
      image.draggable = false;
      this.images.set(address, image);
      this.tiles.append(image);
      this.#load(image, address);
    }
    Object.assign(image.style, { width: `${size}px`, height: `${size}px`, transform: `translate(${Math.round(x)}px, ${Math.round(y)}px)` });
  }

  // By a request of ours: an image of its own accord sends no key.
  async #load(image, address) {
    const mine = (image.asked = (image.asked ?? 0) + 1);
    const answer = await send(address).catch(() => null);
    if (answer?.status !== 200) return;
    const blob = await answer.blob();
    const url = URL.createObjectURL(image.className === "semantic" ? await this.#toned(blob).catch(() => blob) : blob);
    if (mine !== image.asked) return void URL.revokeObjectURL(url); // the scheme has changed meanwhile
    image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
    image.src = url;
  }

  // A picture of classes in the colours of the page's ground.
  async #toned(blob) {
    const pixels = await pixelsOf(blob);
    this.pixels.draw(pixels.data, scheme(), NOTHING);
    const canvas = new OffscreenCanvas(pixels.width, pixels.height);
    canvas.getContext("2d").putImageData(pixels, 0, 0);
    return canvas.convertToBlob({ type: "image/png" });
  }

  #recolour() {
    for (const [address, image] of this.images) if (image.className === "semantic") this.#load(image, address);
  }

  #drawTracks([left, top], width, height) {
    this.lines.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.lines.replaceChildren();
    this.#drawKeys();
    if (this.hidden.has("tracks")) return;
    for (const [id, feature] of this.tracks) {
      for (const line of feature ? linesOf(feature.geometry) : []) {
        const drawn = document.createElementNS(SVG, "polyline");
        const places = line.map(unitFrom).map(([x, y]) => `${(x * this.#world - left).toFixed(1)},${(y * this.#world - top).toFixed(1)}`);
        drawn.setAttribute("points", places.join(" "));
        drawn.setAttribute("class", id === this.chosen ? "chosen" : "");
        this.lines.append(drawn);
      }
    }
  }

  // What the lines mean that are there.
  #drawKeys() {
    const known = this.hidden.has("tracks") ? [] : [...this.tracks].filter(([, feature]) => feature).map(([id]) => id === this.chosen);
    const words = [known.includes(false) && ["drives", ""], known.includes(true) && ["chosen drive", "chosen"]].filter(Boolean);
    this.keys.replaceChildren(...words.map(([text, kind]) => {
      const entry = element("span", "", text);
      entry.prepend(element("i", kind));
      return entry;
    }));
  }

  // Shows a published version; the first one also moves the view there.
  async show(version) {
    const first = this.version === null;
    this.version = version;
    if (first) this.fit();
    else this.#draw();
  }

  async track(drive) {
    if (!drive.placed || this.tracks.has(drive.id)) return;
    this.tracks.set(drive.id, null);
    const feature = await ask(`/v1/drives/${drive.id}/track`).catch(() => null);
    if (!this.tracks.has(drive.id)) return; // forgotten meanwhile
    if (!feature?.geometry) return void this.tracks.delete(drive.id);
    this.tracks.set(drive.id, feature);
    if (drive.id === this.chosen) this.choose(drive.id);
    else if (this.version === null) this.fit();
    else this.#draw();
  }

  async forget(id) {
    if (this.tracks.delete(id)) this.#draw();
  }

  // A plain map tells nobody: what is chosen is chosen in the list.
  hear() {}

  async choose(id) {
    this.chosen = id;
    const feature = this.tracks.get(id);
    if (feature) this.#fitTo(linesOf(feature.geometry).flat());
    this.#draw();
  }

  fit() {
    const [west, south, east, north] = this.version?.bounds ?? [];
    const tracks = [...this.tracks.values()].filter(Boolean).flatMap((one) => linesOf(one.geometry).flat());
    this.#fitTo(this.version?.bounds ? [[west, south], [east, north]] : tracks);
  }

  #fitTo(places) {
    if (!places.length) return;
    const units = places.map(unitFrom);
    const [low, high] = [Math.min, Math.max].map((pick) => [0, 1].map((k) => units.reduce((so, one) => pick(so, one[k]), units[0][k])));
    const span = low.map((one, k) => Math.max(high[k] - one, 1e-9));
    const { left, top, right, bottom } = roomOn(this.view, span[0] / span[1]);
    this.zoom = Math.max(LOWEST, Math.min(20, Math.floor(Math.log2(Math.min((right - left) / span[0], (bottom - top) / span[1]) / TILE))));
    const beside = [(left + right - this.view.clientWidth) / 2, (top + bottom - this.view.clientHeight) / 2];
    this.centre = low.map((one, k) => (one + high[k]) / 2 - beside[k] / this.#world);
    this.#draw();
  }

  async visible(name, on) {
    if (on) this.hidden.delete(name);
    else this.hidden.add(name);
    this.#draw();
  }
}
