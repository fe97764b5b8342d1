// The map: a plain grid below, the orthophoto and over it the classes as tiles of the published version, coverage, the drives' tracks.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { ask, headers } from "/static/api.js";
import { Coverage } from "/static/map/coverage.js";
import { knowClasses } from "/static/map/shown_classes.js";
import { grid } from "/static/map/style.js";
import { placesOf, Tracks } from "/static/map/tracks.js";
import { VersionLayers } from "/static/map/version_layers.js";

// The map of this page; about: { info } with the answer of /v1/info.
export function mountMap(container, { info }) {
  const city = new CityMap(container, info.overlays);
  knowClasses(info.classes.filter((one) => one.in_map));
  globalThis.wayloomMap = city.map;
  return city;
}

export const plainStyle = () => ({ version: 8, sources: { grid: grid() }, layers: [{ id: "grid", type: "raster", source: "grid" }] });
export const withKey = (url) => ({ url, headers: url.startsWith(location.origin) ? headers() : {} });

export class CityMap {
  // overlays: names of the layers that are drawn over the classes where they are asked for.
  constructor(container, overlays) {
    this.overlays = overlays;
    this.bounds = null;
    this.held = false;
    this.heard = { version: [], visible: [], chosen: [] };
    this.map = new maplibregl.Map({
      container, attributionControl: false, fadeDuration: 0, maxPitch: 0, dragRotate: false, center: [10, 48], zoom: 3,
      transformRequest: withKey, style: plainStyle(),
    });
    this.map.touchZoomRotate.disableRotation();
    this.map.keyboard.disableRotation();
    this.map.addControl(new maplibregl.NavigationControl({ showCompass: false }), "top-right");
    this.map.addControl(new maplibregl.ScaleControl({ maxWidth: 140 }), "bottom-right");
    this.coverage = new Coverage(this.map, ask);
    this.tracks = new Tracks(this.map, ask);
    this.layers = new VersionLayers(this.map, overlays, "coverage");
    this.ready = new Promise((resolve) => this.map.once("style.load", resolve)).then(() => {
      this.coverage.addLayers();
      this.tracks.addLayers();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#recolour());
  }

  #recolour() {
    this.map.removeLayer("grid");
    this.map.removeSource("grid");
    this.map.addSource("grid", grid());
    this.map.addLayer({ id: "grid", type: "raster", source: "grid" }, this.map.getStyle().layers[0]?.id);
    this.coverage.recolour();
    this.tracks.recolour();
  }

  // hear(what, work): work is called when the version that is shown, what is visible, or the chosen drive has changed.
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
    await this.coverage.show(version);
    if (first && !this.held) this.fit();
  }

  // Shows one version whatever is published; null: the newest again.
  async pin(version) {
    await this.ready;
    this.pinned = version;
    if (version ?? this.newest) this.layers.show(version ?? this.newest);
    this.#tell("version", version ?? this.newest);
  }

  get shown() {
    return this.pinned ?? this.newest ?? null;
  }

  async track(drive) {
    await this.ready;
    if ((await this.tracks.take(drive)) && this.bounds === null && !this.held) this.fit();
  }

  async forget(id) {
    await this.ready;
    this.tracks.forget(id);
  }

  async choose(id, before, fits = true) {
    await this.ready;
    const was = before ?? this.chosen;
    if (was) this.map.setFeatureState({ source: "tracks", id: was }, { chosen: false });
    this.chosen = id;
    this.#tell("chosen", id);
    const feature = this.tracks.drives.get(id);
    if (!feature) return;
    this.map.setFeatureState({ source: "tracks", id }, { chosen: true });
    if (fits) this.fitTo(placesOf(feature));
  }

  fit() {
    const [west, south, east, north] = this.bounds ?? [];
    // Across the antimeridian west is the greater.
    const corners = this.bounds ? [[west, south], [east < west ? east + 360 : east, north]] : this.tracks.features.flatMap(placesOf);
    this.fitTo(corners);
  }

  fitTo(places) {
    if (!places.length) return;
    const box = places.reduce((found, [lon, lat]) => found.extend([lon, lat]), new maplibregl.LngLatBounds());
    const duration = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : 600;
    this.map.fitBounds(box, { padding: 60, maxZoom: 20, duration });
  }

  async visible(name, on) {
    await this.ready;
    if (name === "tracks" || name === "coverage") {
      for (const id of name === "tracks" ? ["tracks-edge", "tracks"] : [name]) this.map.setLayoutProperty(id, "visibility", on ? "visible" : "none");
    } else {
      this.layers.visible(name, on);
    }
    this.#tell("visible", name);
  }
}
