// The drives' ways, in one colour or by vehicle, age or grade.

import { AGE_RAMP, colour, GRADES, PALETTE, ramped } from "/static/map/style.js";

const EMPTY = { type: "FeatureCollection", features: [] };
export const TRACK_MODES = ["plain", "vehicle", "age", "grade"];
const NONE = "#8a949b";
const CHOSEN = "#e0662a";

// Every place of a track, which the antimeridian may cut in two lines.
export const placesOf = (feature) => {
  if (!feature) return [];
  const { type, coordinates } = feature.geometry;
  if (type === "LineString") return coordinates;
  return coordinates.flat().map(([lon, ...rest]) => [lon < 0 ? lon + 360 : lon, ...rest]);
};

// When the drive was driven by its log's clock, else when it arrived; seconds since 1970.
function drivenAt({ facts, uploaded_at: uploaded, created_at: created }) {
  const start = Date.parse(`${facts?.log?.start ?? ""}`.slice(0, 23).replace(" ", "T") + "Z");
  return Number.isNaN(start) ? (uploaded ?? created) : start / 1000;
}

const about = (drive) => ({
  id: drive.id, name: drive.name, vehicle: drive.vehicle_id ?? "", when: drivenAt(drive),
  grade: drive.quality?.by_map?.grade ?? drive.quality?.grade ?? "",
});

export class Tracks {
  constructor(map, ask) {
    Object.assign(this, { map, ask, mode: "plain", chosen: null, drives: new Map(), changed: () => {} });
  }

  addLayers() {
    this.map.addSource("tracks", { type: "geojson", data: EMPTY, promoteId: "id" });
    const line = { "line-cap": "round", "line-join": "round" };
    this.map.addLayer({
      id: "tracks-edge", type: "line", source: "tracks", layout: line,
      paint: { "line-color": "#ffffff", "line-width": this.#chosen(6, 4), "line-opacity": 0.75 },
    });
    this.map.addLayer({ id: "tracks", type: "line", source: "tracks", layout: line, paint: { "line-color": this.#tone(), "line-width": this.#chosen(3.5, 2) } });
  }

  #chosen(yes, no) {
    return ["case", ["boolean", ["feature-state", "chosen"], false], yes, no];
  }

  // Whether it is a new one that has a way. The way is asked for once, what is known of the drive may change.
  async take(drive) {
    if (!drive.placed) return false;
    const known = this.drives.get(drive.id);
    if (known === null) return false;
    if (known) {
      if (JSON.stringify(known.properties) !== JSON.stringify(about(drive))) this.#keep(known, drive);
      return false;
    }
    this.drives.set(drive.id, null);
    const feature = await this.ask(`/v1/drives/${drive.id}/track`).catch(() => null);
    if (!this.drives.has(drive.id)) return false; // forgotten meanwhile
    if (!feature?.geometry) return void this.drives.delete(drive.id);
    this.#keep(feature, drive);
    return true;
  }

  #keep(feature, drive) {
    this.drives.set(drive.id, { ...feature, properties: about(drive) });
    this.draw();
  }

  forget(id) {
    if (this.drives.delete(id)) this.draw();
  }

  get features() {
    return [...this.drives.values()].filter(Boolean);
  }

  // The line of one drive stands out, whether its way is here or comes later.
  mark(id, on) {
    this.map.setFeatureState({ source: "tracks", id }, { chosen: on });
    this.chosen = on ? id : null;
    this.changed();
  }

  draw() {
    this.map.getSource("tracks")?.setData({ type: "FeatureCollection", features: this.features });
    this.recolour();
  }

  by(mode) {
    this.mode = TRACK_MODES.includes(mode) ? mode : "plain";
    this.recolour();
  }

  recolour() {
    if (this.map.getLayer("tracks")) this.map.setPaintProperty("tracks", "line-color", this.#chosen(CHOSEN, this.#tone()));
    this.changed();
  }

  // [[words, colour]] of what the colours mean; those of ages are a ramp's.
  legend() {
    return [...this.#tones(), ...(this.drives.get(this.chosen) ? [["chosen drive", CHOSEN]] : [])];
  }

  #tones() {
    const known = this.features.map(({ properties }) => properties);
    if (this.mode === "vehicle") return this.#vehicles().map(([name, tone]) => [name || "no vehicle", tone]);
    if (this.mode === "grade") return [...Object.entries(GRADES), ["none", NONE]].filter(([grade]) => known.some((one) => (one.grade || "none") === grade));
    return this.mode === "plain" && known.length ? [["drives", colour("--accent")]] : [];
  }

  // Oldest and newest, seconds since 1970.
  ages() {
    const when = this.features.map(({ properties }) => properties.when);
    const [low, high] = [Math.min(...when), Math.max(...when)];
    return Number.isFinite(low) ? [low, high > low ? high : low + 1] : [0, 1];
  }

  #vehicles() {
    const names = [...new Set(this.features.map(({ properties }) => properties.vehicle))].sort();
    return names.map((name, row) => [name, name ? PALETTE[row % PALETTE.length] : NONE]);
  }

  #tone() {
    const vehicles = this.#vehicles();
    if (this.mode === "vehicle" && vehicles.length) return ["match", ["get", "vehicle"], ...vehicles.flat(), NONE];
    if (this.mode === "grade") return ["match", ["get", "grade"], ...Object.entries(GRADES).flat(), NONE];
    if (this.mode === "age") return ramped(["get", "when"], this.ages(), AGE_RAMP);
    return colour("--accent");
  }
}
