// The map: a plain grid below, the orthophoto and over it the classes as tiles of the published version, coverage, the drives' tracks.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { ask, headers } from "/static/api.js";
import { Coverage } from "/static/map/coverage.js";
import { Excluded } from "/static/map/excluded.js";
import { noteClasses } from "/static/map/overlay_classes.js";
import { roomOn } from "/static/map/room.js";
import { knowClasses } from "/static/map/shown_classes.js";
import { BESIDE_M, wider } from "/static/map/sites.js";
import { grid, renewGrid } from "/static/map/style.js";
import { placesOf, Tracks } from "/static/map/tracks.js";
import { VersionLayers } from "/static/map/version_layers.js";
import { whenSchemeChanges } from "/static/ui/tones.js";

// The map of this page; about: { info } with the answer of /v1/info.
export function mountMap(container, { info }) {
  const city = new CityMap(container, info.overlays);
  knowClasses(info.classes);
  noteClasses(info.classes);
  globalThis.wayloomMap = city.map;
  return city;
}

export const plainStyle = () => ({ version: 8, sources: { grid: grid() }, layers: [{ id: "grid", type: "raster", source: "grid" }] });
export const withKey = (url) => ({ url, headers: url.startsWith(location.origin) ? headers() : {} });

// Ids of the layers that are no version's, by what they show.
export const OWN_LAYERS = { tracks: ["tracks-edge", "tracks"], coverage: ["coverage"], excluded: ["excluded", "excluded-edge"] };

export class CityMap {
  // overlays: names of the layers that are drawn over the classes where they are asked for.
  constructor(container, overlays) {
    this.overlays = overlays;
    this.bounds = null;
    this.held = false;
    this.isFitted = false;
    this.heard = { version: [], visible: [], chosen: [], tracks: [] };
    this.chosen = null;
    this.awaited = null;
    this.map = new maplibregl.Map({
      container, attributionControl: false, fadeDuration: 0, maxPitch: 0, dragRotate: false, center: [10, 48], zoom: 3,
      transformRequest: withKey, style: plainStyle(),
    });
    this.map.touchZoomRotate.disableRotation();
    this.map.keyboard.disableRotation();
    this.map.addControl(new maplibregl.NavigationControl({ showCompass: false }), "top-right");
    this.map.addControl(new maplibregl.ScaleControl({ maxWidth: 140 }), "bottom-right");
    this.coverage = new Coverage(this.map, ask);
    this.excluded = new Excluded(this.map);
    this.tracks = new Tracks(this.map, ask);
    this.tracks.changed = () => this.#tell("tracks");
    this.layers = new VersionLayers(this.map, overlays, "coverage", "tracks-edge");
    this.ready = new Promise((resolve) => this.map.once("style.load", resolve)).then(() => {
      this.coverage.addLayers();
      this.excluded.addLayers();
      this.tracks.addLayers();
    });
    this.map.on("movestart", ({ isFit }) => (this.isFitted &&= Boolean(isFit)));
    whenSchemeChanges(() => this.#recolour());
  }

  #recolour() {
    renewGrid(this.map);
    this.coverage.recolour();
    this.excluded.recolour();
    this.tracks.recolour();
    this.layers.recolour();
    this.other?.recolour();
  }

  // hear(what, work): work is called when the version that is shown, what is visible, the chosen drive, or a way of a drive has changed.
  hear(what, work) {
    this.heard[what].push(work);
  }

  #tell(what, value) {
    for (const work of this.heard[what]) work(value);
  }

  // Shows the newest version; the first one also moves the view there, unless the page's address names a place.
  async show(version) {
    await this.ready;
    const first = this.bounds === null;
    this.bounds = version.bounds;
    this.newest = version;
    if (!this.pinned) this.layers.show(version);
    this.#tell("version", version);
    this.excluded.refresh(ask);
    await this.coverage.show(this.shown);
    if (first && !this.held) this.fit();
  }

  // Shows one version whatever is published; null: the newest again.
  async pin(version) {
    await this.ready;
    this.pinned = version;
    if (version ?? this.newest) this.layers.show(version ?? this.newest);
    this.#tell("version", version ?? this.newest);
    if (this.shown) await this.coverage.show(this.shown);
  }

  get shown() {
    return this.pinned ?? this.newest ?? null;
  }

  async track(drive) {
    await this.ready;
    if (!drive || !(await this.tracks.take(drive))) return;
    if (drive.id === this.awaited) this.#fitToDrive(drive.id);
    else if (this.bounds === null && !this.held) this.fit();
  }

  async forget(id) {
    await this.ready;
    this.tracks.forget(id);
  }

  // id: of a drive, or null. fits: whether the view goes to its way, as soon as that is here.
  async choose(id, fits = true) {
    const was = this.chosen;
    this.chosen = id;
    this.awaited = fits ? id : null;
    this.#tell("chosen", id);
    await this.ready;
    if (was) this.tracks.mark(was, false);
    if (!id || id !== this.chosen) return;
    this.tracks.mark(id, true);
    if (fits) this.#fitToDrive(id);
  }

  #fitToDrive(id) {
    const feature = this.tracks.drives.get(id);
    if (!feature) return;
    this.awaited = null;
    this.fitTo(placesOf(feature));
  }

  // Everywhere that drives have covered, with the fronts beside; the map's own bounds reach as far as the farthest thing seen.
  fit() {
    this.#fitOnce();
    this.map.once("idle", () => this.refit()); // the legend has grown by what is in sight now
  }

  // Once more, when panels have come meanwhile, unless the view has gone elsewhere.
  refit() {
    if (this.isFitted) this.#fitOnce();
  }

  #fitOnce() {
    // Across the antimeridian west is the greater.
    const isPlain = this.bounds && this.bounds[0] <= this.bounds[2];
    const [west, south, east, north] = (isPlain && this.coverage.box && wider(this.coverage.box, BESIDE_M)) || this.bounds || [];
    const corners = this.bounds ? [[west, south], [east < west ? east + 360 : east, north]] : this.tracks.features.flatMap(placesOf);
    this.fitTo(corners);
    this.isFitted = corners.length > 0;
  }

  // Into the room that panels leave.
  fitTo(places) {
    this.isFitted = false;
    if (!places.length) return;
    const box = places.reduce((found, [lon, lat]) => found.extend([lon, lat]), new maplibregl.LngLatBounds());
    const [low, high] = [box.getSouthWest(), box.getNorthEast()].map((corner) => maplibregl.MercatorCoordinate.fromLngLat(corner));
    const container = this.map.getContainer();
    const { left, top, right, bottom } = roomOn(container, (high.x - low.x) / (low.y - high.y) || 1);
    const padding = { left, top, right: container.clientWidth - right, bottom: container.clientHeight - bottom };
    const duration = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : 600;
    this.map.fitBounds(box, { padding, maxZoom: 20, duration }, { isFit: true });
  }

  async visible(name, on) {
    await this.ready;
    if (name in OWN_LAYERS) {
      for (const id of OWN_LAYERS[name]) this.map.setLayoutProperty(id, "visibility", on ? "visible" : "none");
    } else {
      this.layers.visible(name, on);
    }
    this.#tell("visible", name);
  }
}
