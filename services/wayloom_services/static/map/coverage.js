// Where the map is: areas along the streets, or squares by how many drives came, or by when the last one did.

import { boxOf, joined } from "/static/map/sites.js";
import { AGE_RAMP, colour, COUNT_RAMP, ramped } from "/static/map/style.js";

const EMPTY = { type: "FeatureCollection", features: [] };
export const COVERAGE_MODES = ["plain", "drives", "age"];

export class Coverage {
  constructor(map, ask) {
    Object.assign(this, { map, ask, mode: "plain", version: null, streets: EMPTY, visits: null, changed: () => {}, known: () => {} });
  }

  addLayers() {
    this.map.addSource("coverage", { type: "geojson", data: EMPTY });
    this.map.addLayer({
      id: "coverage", type: "fill", source: "coverage", layout: { visibility: "none" },
      paint: { "fill-color": colour("--accent"), "fill-opacity": 0.18, "fill-outline-color": colour("--accent") },
    });
  }

  // Coverage is that of the newest version; an older one keeps what is shown.
  async show(version) {
    this.version = version;
    this.visits = null;
    this.streets = await this.ask(`/v1/maps/${version.map_id}/coverage`);
    this.known(this.streets.features);
    await this.#draw();
  }

  // Around all areas; null of none.
  get box() {
    const boxes = this.streets.features.map(({ geometry }) => boxOf(geometry));
    return boxes.length ? boxes.reduce(joined) : null;
  }

  async by(mode) {
    this.mode = COVERAGE_MODES.includes(mode) ? mode : "plain";
    await this.#draw();
  }

  async #draw() {
    if (!this.map.getLayer("coverage")) return;
    if (this.mode !== "plain" && !this.visits && this.version) this.visits = await this.ask(`/v1/maps/${this.version.map_id}/coverage?of=visits`);
    this.map.getSource("coverage").setData(this.mode === "plain" || !this.visits ? this.streets : this.visits);
    this.recolour();
  }

  // Lowest and highest of what is coloured.
  range() {
    const name = this.mode === "age" ? "last_seen" : "drives";
    const values = (this.visits?.features ?? []).map(({ properties }) => properties[name]);
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
    this.changed();
  }
}
