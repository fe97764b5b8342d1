// Where the map is: areas along the streets, or squares by how many drives came, or by when the last one did.

import { boxOf, joined } from "/static/map/sites.js";
import { AGE_RAMP, colour, COUNT_RAMP, ramped } from "/static/map/style.js";

const EMPTY = { type: "FeatureCollection", features: [] };
export const COVERAGE_MODES = ["plain", "drives", "age"];

export class Coverage {
  // main: the coverage of the other map, whose ramp this one shares, where two versions are compared.
  constructor(map, ask, main = null) {
    Object.assign(this, { map, ask, main, mode: main?.mode ?? "plain", version: null, streets: EMPTY, visits: null, beside: null });
    Object.assign(this, { changed: () => {}, known: () => {} });
  }

  addLayers() {
    this.map.addSource("coverage", { type: "geojson", data: EMPTY });
    this.map.addLayer({
      id: "coverage", type: "fill", source: "coverage", layout: { visibility: "none" },
      paint: { "fill-color": colour("--accent"), "fill-opacity": 0.18, "fill-outline-color": colour("--accent") },
    });
  }

  async show(version) {
    this.version = version;
    this.visits = null;
    const streets = await this.#of("streets");
    if (this.version !== version) return;
    this.streets = streets;
    this.known(streets.features);
    await this.#draw();
  }

  #of(what) {
    return this.ask(`/v1/maps/${this.version.map_id}/coverage?of=${what}&version=${this.version.version}`);
  }

  // Around all areas; null of none.
  get box() {
    const boxes = this.streets.features.map(({ geometry }) => boxOf(geometry));
    return boxes.length ? boxes.reduce(joined) : null;
  }

  async by(mode) {
    this.mode = COVERAGE_MODES.includes(mode) ? mode : "plain";
    await Promise.all([this.#draw(), this.beside?.by(mode)]);
  }

  async #draw() {
    if (!this.map.getLayer("coverage")) return;
    const { version } = this;
    if (this.mode !== "plain" && !this.visits && version) {
      const visits = await this.#of("visits");
      if (this.version !== version || !this.map.getLayer("coverage")) return;
      this.visits = visits;
    }
    this.map.getSource("coverage").setData(this.mode === "plain" || !this.visits ? this.streets : this.visits);
    (this.main ?? this).recolour();
  }

  // Lowest and highest of what is coloured, of both versions where two are compared.
  range() {
    const name = this.mode === "age" ? "last_seen" : "drives";
    const both = this.main ? [this.main, this] : [this, this.beside];
    const values = both.flatMap((one) => one?.visits?.features ?? []).map(({ properties }) => properties[name]);
    const [low, high] = values.reduce(([least, most], value) => [Math.min(least, value), Math.max(most, value)], [Infinity, -Infinity]);
    return Number.isFinite(low) ? [low, high > low ? high : low + 1] : [0, 1];
  }

  recolour() {
    if (!this.map.getLayer("coverage")) return;
    const plain = this.mode === "plain";
    const value = ["get", this.mode === "age" ? "last_seen" : "drives"];
    this.map.setPaintProperty("coverage", "fill-color", plain ? colour("--accent") : ramped(value, this.range(), this.mode === "age" ? AGE_RAMP : COUNT_RAMP));
    this.map.setPaintProperty("coverage", "fill-opacity", plain ? 0.18 : 0.6);
    this.map.setPaintProperty("coverage", "fill-outline-color", plain ? colour("--accent") : "rgba(0, 0, 0, 0)");
    this.beside?.recolour();
    this.changed();
  }
}
