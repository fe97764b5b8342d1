// Two versions side by side: a second map over the first, cut off at a line that a pointer or the keyboard moves.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { ask } from "/static/api.js";
import { element } from "/static/ui/dom.js";
import { OWN_LAYERS, plainStyle, withKey } from "/static/map.js";
import { Coverage } from "/static/map/coverage.js";
import { Excluded } from "/static/map/excluded.js";
import { renewGrid } from "/static/map/style.js";
import { Tracks } from "/static/map/tracks.js";
import { VersionLayers } from "/static/map/version_layers.js";
import { whenSchemeChanges } from "/static/ui/tones.js";

export class Swipe {
  // changed(): the line has been moved.
  constructor(city, changed) {
    Object.assign(this, { city, changed, share: 0.5, version: null });
    this.box = element("div", "");
    this.box.id = "swipe-map";
    this.line = element("div", "");
    Object.assign(this.line, { id: "swipe-line", tabIndex: 0, role: "slider", ariaLabel: "Line between the two versions", ariaValueMin: 0, ariaValueMax: 100 });
    this.names = ["left", "right"].map((side) => element("span", `pill swipe-name ${side}`));
    this.line.append(...this.names);
    city.map.getContainer().append(this.box, this.line);
    this.#hide(true);
    this.line.addEventListener("pointerdown", (event) => this.line.setPointerCapture(event.pointerId));
    this.line.addEventListener("pointermove", (event) => this.line.hasPointerCapture(event.pointerId) && this.#to(event.clientX));
    this.line.addEventListener("keydown", (event) => this.#key(event));
    whenSchemeChanges(() => this.#recolour());
    city.hear("version", () => this.#name());
    city.hear("visible", (name) => this.#follow(name));
    city.hear("tracks", () => this.#followTracks());
    city.hear("chosen", (id) => this.#followChoice(id));
  }

  #hide(hidden) {
    for (const one of [this.box, this.line]) one.hidden = hidden;
  }

  get on() {
    return this.version !== null;
  }

  // The version to the right of the line.
  async show(version) {
    this.version = version;
    this.#hide(false);
    this.move(this.share);
    await this.#open();
    if (this.version !== version) return;
    this.layers.show(version);
    this.#name();
    await this.coverage.show(version);
  }

  async #open() {
    if (this.map) return this.ready;
    const { map } = this.city;
    this.map = new maplibregl.Map({
      container: this.box, interactive: false, attributionControl: false, fadeDuration: 0, transformRequest: withKey, style: plainStyle(),
      center: map.getCenter(), zoom: map.getZoom(),
    });
    this.keep = () => this.map?.jumpTo({ center: map.getCenter(), zoom: map.getZoom() });
    map.on("move", this.keep);
    globalThis.wayloomOther = this.map;
    const other = this.map;
    this.ready = new Promise((resolve) => other.once("style.load", resolve)).then(() => {
      if (this.map !== other) return;
      this.coverage = this.city.coverage.beside = new Coverage(this.map, ask, this.city.coverage);
      this.coverage.addLayers();
      this.excluded = this.city.excluded.beside = new Excluded(this.map);
      this.excluded.addLayers();
      this.excluded.take(this.city.excluded.areas);
      this.tracks = new Tracks(this.map, null);
      this.tracks.addLayers();
      this.#followTracks();
      this.marked = null;
      this.#followChoice(this.city.chosen);
      for (const name of Object.keys(OWN_LAYERS)) this.#follow(name);
      this.layers = new VersionLayers(this.map, this.city.overlays, "coverage", "tracks-edge");
      this.layers.off = new Set(this.city.layers.off);
      this.layers.hidden = this.city.layers.hidden;
      this.layers.kinds = this.city.layers.kinds;
      this.city.other = this.layers;
    });
    return this.ready;
  }

  close() {
    this.version = null;
    this.#hide(true);
    if (!this.map) return;
    this.city.map.off("move", this.keep);
    this.map.remove();
    if (this.coverage) this.coverage.version = null; // what it still waits for comes too late
    Object.assign(this, { map: null, layers: null, tracks: null, coverage: null, excluded: null });
    this.city.other = this.city.coverage.beside = this.city.excluded.beside = null;
    this.city.coverage.recolour();
  }

  // Versions and coverage are recoloured by the main map.
  #recolour() {
    if (!this.layers) return;
    renewGrid(this.map);
    this.excluded.recolour();
    this.tracks.recolour();
  }

  #followTracks() {
    if (!this.tracks) return;
    Object.assign(this.tracks, { drives: this.city.tracks.drives, mode: this.city.tracks.mode });
    this.tracks.draw();
  }

  #followChoice(id) {
    if (!this.tracks) return;
    if (this.marked) this.tracks.mark(this.marked, false);
    if (id) this.tracks.mark(id, true);
    this.marked = id;
  }

  #follow(name) {
    if (!this.tracks) return;
    const on = (id) => this.city.map.getLayer(id) && this.city.map.getLayoutProperty(id, "visibility") !== "none";
    if (name in OWN_LAYERS) for (const id of OWN_LAYERS[name]) this.map.setLayoutProperty(id, "visibility", on(id) ? "visible" : "none");
    else this.layers?.visible(name, !this.city.layers.off.has(name));
  }

  #name() {
    if (!this.on) return;
    this.names[0].textContent = `version ${this.city.shown?.version ?? "?"}`;
    this.names[1].textContent = `version ${this.version.version}`;
  }

  #to(clientX) {
    const { left, width } = this.city.map.getContainer().getBoundingClientRect();
    this.move((clientX - left) / width);
    this.changed();
  }

  #key(event) {
    const steps = { ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 };
    if (!(event.key in steps)) return;
    event.preventDefault();
    this.move(this.share + steps[event.key]);
    this.changed();
  }

  // share: of the map that lies to the left of the line.
  move(share) {
    this.share = Math.min(Math.max(share, 0), 1);
    const at = `${(100 * this.share).toFixed(1)}%`;
    this.box.style.clipPath = `inset(0 0 0 ${at})`;
    this.line.style.left = at;
    this.line.ariaValueNow = String(Math.round(100 * this.share));
    this.line.ariaValueText = `${Math.round(100 * this.share)} percent from the left`;
  }
}
