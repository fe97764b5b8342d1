// The map: a plain grid below, the orthophoto and over it the classes as tiles of the published version, coverage, the drives' tracks.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { ask, headers } from "/static/api.js";

const EMPTY = { type: "FeatureCollection", features: [] };
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Squares of the tile grid, drawn here: the page works without any map service.
maplibregl.addProtocol("grid", async () => {
  const canvas = new OffscreenCanvas(256, 256);
  const pen = canvas.getContext("2d");
  pen.fillStyle = colour("--map");
  pen.fillRect(0, 0, 256, 256);
  pen.strokeStyle = colour("--grid");
  for (const [at, width] of [[0, 1.5], [64, 0.5], [128, 0.5], [192, 0.5]]) {
    pen.lineWidth = width;
    pen.beginPath();
    pen.moveTo(at, 0);
    pen.lineTo(at, 256);
    pen.moveTo(0, at);
    pen.lineTo(256, at);
    pen.stroke();
  }
  return { data: await (await canvas.convertToBlob({ type: "image/png" })).arrayBuffer() };
});

// Vector tiles of features by their names: the layers within a tile, and how they are drawn, over the photograph and the classes.
const byKind = (colours, otherwise) => ["match", ["get", "kind"], ...Object.entries(colours).flat(), otherwise];
const FEATURES = {
  areas: {
    areas: {
      type: "fill", minzoom: 15,
      paint: { "fill-color": byKind({ road: "#804080", sidewalk: "#f423e8" }, "#98fb98"), "fill-opacity": 0.35, "fill-antialias": false },
    },
  },
  markings: {
    kerbs: { type: "line", minzoom: 18, layout: { "line-cap": "round" }, paint: { "line-color": "#ffd23f", "line-width": 2 } },
    markings: {
      type: "line", minzoom: 18, layout: { "line-cap": "round" },
      paint: { "line-color": "#1fd1ff", "line-width": ["interpolate", ["linear"], ["zoom"], 18, 1.5, 21, 4] },
    },
  },
  objects: {
    objects: {
      type: "circle", minzoom: 16,
      paint: {
        "circle-color": byKind({ pole: "#999999", traffic_sign: "#dcdc00", traffic_light: "#faaa1e" }, "#6b8e23"),
        "circle-radius": ["interpolate", ["linear"], ["zoom"], 16, 2.5, 21, 7],
        "circle-stroke-color": "#ffffff", "circle-stroke-width": 1.2,
      },
    },
  },
};
const HIDDEN = new Set(["areas"]);

// Every place of a track, which the antimeridian may cut in two lines.
const placesOf = (feature) => {
  if (!feature) return [];
  const { type, coordinates } = feature.geometry;
  if (type === "LineString") return coordinates;
  return coordinates.flat().map(([lon, ...rest]) => [lon < 0 ? lon + 360 : lon, ...rest]);
};

// The map of this page; about: { info } with the answer of /v1/info.
export function mountMap(container, { info }) {
  const city = new CityMap(container, info.overlays);
  globalThis.wayloomMap = city.map;
  return city;
}

const grid = () => ({ type: "raster", tiles: ["grid://{z}/{x}/{y}"], tileSize: 256, maxzoom: 22 });

export class CityMap {
  // overlays: names of the layers that are drawn over the classes where they are asked for.
  constructor(container, overlays) {
    this.overlays = overlays;
    this.tracks = new Map();
    this.bounds = null;
    this.map = new maplibregl.Map({
      container,
      attributionControl: false,
      fadeDuration: 0,
      maxPitch: 0,
      dragRotate: false,
      center: [10, 48],
      zoom: 3,
      transformRequest: (url) => ({ url, headers: url.startsWith(location.origin) ? headers() : {} }),
      style: { version: 8, sources: { grid: grid() }, layers: [{ id: "grid", type: "raster", source: "grid" }] },
    });
    this.map.touchZoomRotate.disableRotation();
    this.map.addControl(new maplibregl.NavigationControl({ showCompass: false }), "top-right");
    this.map.addControl(new maplibregl.ScaleControl({ maxWidth: 140 }), "bottom-right");
    this.ready = new Promise((resolve) => this.map.once("load", resolve)).then(() => this.#addLayers());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#recolour());
  }

  #addLayers() {
    this.map.addSource("coverage", { type: "geojson", data: EMPTY });
    this.map.addSource("tracks", { type: "geojson", data: EMPTY, promoteId: "id" });
    this.map.addLayer({
      id: "coverage", type: "fill", source: "coverage", layout: { visibility: "none" },
      paint: { "fill-color": colour("--accent"), "fill-opacity": 0.18, "fill-outline-color": colour("--accent") },
    });
    const line = { "line-cap": "round", "line-join": "round" };
    const chosen = (yes, no) => ["case", ["boolean", ["feature-state", "chosen"], false], yes, no];
    this.map.addLayer({
      id: "tracks-edge", type: "line", source: "tracks", layout: line,
      paint: { "line-color": "#ffffff", "line-width": chosen(6, 4), "line-opacity": 0.75 },
    });
    this.map.addLayer({
      id: "tracks", type: "line", source: "tracks", layout: line,
      paint: { "line-color": chosen("#e0662a", colour("--accent")), "line-width": chosen(3.5, 2) },
    });
    this.#tellObjects();
  }

  #recolour() {
    this.map.removeLayer("grid");
    this.map.removeSource("grid");
    this.map.addSource("grid", grid());
    this.map.addLayer({ id: "grid", type: "raster", source: "grid" }, this.map.getStyle().layers[0]?.id);
  }

  // Shows a published version; the first one also moves the view there.
  async show(version) {
    await this.ready;
    const first = this.bounds === null;
    this.bounds = version.bounds;
    this.#showPictures(version, "ortho", "visible");
    this.#showPictures(version, "semantic", "visible");
    for (const name of this.overlays) this.#showPictures(version, name, "none");
    for (const name of Object.keys(FEATURES)) this.#showFeatures(version, name);
    this.map.getSource("coverage").setData(await ask(`/v1/maps/${version.map_id}/coverage`));
    if (first) this.fit();
  }

  // A layer of pictures in the place of that of the version before, as visible as that was.
  #showPictures(version, name, otherwise) {
    const layer = version.layers[name];
    const visibility = this.map.getLayer(name) ? this.map.getLayoutProperty(name, "visibility") : otherwise;
    if (this.map.getLayer(name)) {
      this.map.removeLayer(name);
      this.map.removeSource(name);
    }
    if (!layer) return;
    const photo = name === "ortho";
    const tiles = [`${location.origin}/v1/maps/${version.map_id}/versions/${version.version}/tiles/${name}/{z}/{x}/{y}.${photo ? "webp" : "png"}`];
    this.map.addSource(name, {
      type: "raster", tiles, tileSize: photo ? 512 : 256, minzoom: layer.min_zoom, maxzoom: layer.max_zoom,
      ...(version.bounds[0] <= version.bounds[2] ? { bounds: version.bounds } : {}),
    });
    this.map.addLayer(
      { id: name, type: "raster", source: name, layout: { visibility }, paint: { "raster-resampling": photo ? "linear" : "nearest" } },
      "coverage",
    );
  }

  // Features in the place of those of the version before, as visible as they were.
  #showFeatures(version, name) {
    const layer = version.layers[name];
    const ids = Object.keys(FEATURES[name]);
    const before = ids.find((id) => this.map.getLayer(id));
    const visibility = before ? this.map.getLayoutProperty(before, "visibility") : HIDDEN.has(name) ? "none" : "visible";
    for (const id of ids) if (this.map.getLayer(id)) this.map.removeLayer(id);
    if (this.map.getSource(name)) this.map.removeSource(name);
    if (!layer) return;
    this.map.addSource(name, {
      type: "vector", minzoom: layer.min_zoom, maxzoom: layer.max_zoom,
      tiles: [`${location.origin}/v1/maps/${version.map_id}/versions/${version.version}/tiles/${name}/{z}/{x}/{y}.mvt`],
      ...(version.bounds[0] <= version.bounds[2] ? { bounds: version.bounds } : {}),
    });
    for (const [id, drawn] of Object.entries(FEATURES[name])) {
      this.map.addLayer({ ...drawn, id, source: name, "source-layer": id, layout: { ...drawn.layout, visibility } }, "coverage");
    }
  }

  // A click on an object tells what is known of it.
  #tellObjects() {
    this.map.on("click", "objects", ({ features: [found] }) => {
      const table = document.createElement("table");
      for (const [name, value] of Object.entries(found.properties)) {
        const row = table.insertRow();
        row.insertCell().textContent = name.replaceAll("_", " ");
        row.insertCell().textContent = typeof value === "number" ? String(Number(value.toFixed(3))) : value;
      }
      new maplibregl.Popup({ className: "about", maxWidth: "22rem" })
        .setLngLat(found.geometry.coordinates).setDOMContent(table).addTo(this.map);
    });
    this.map.on("mouseenter", "objects", () => (this.map.getCanvas().style.cursor = "pointer"));
    this.map.on("mouseleave", "objects", () => (this.map.getCanvas().style.cursor = ""));
  }

  async track(drive) {
    if (!drive.placed || this.tracks.has(drive.id)) return;
    this.tracks.set(drive.id, null);
    const feature = await ask(`/v1/drives/${drive.id}/track`).catch(() => null);
    if (!feature?.geometry) return void this.tracks.delete(drive.id);
    this.tracks.set(drive.id, feature);
    await this.#drawTracks();
    if (this.bounds === null) this.fit();
  }

  async forget(id) {
    if (this.tracks.delete(id)) await this.#drawTracks();
  }

  async #drawTracks() {
    await this.ready;
    this.map.getSource("tracks").setData({ type: "FeatureCollection", features: [...this.tracks.values()].filter(Boolean) });
  }

  async choose(id, before) {
    await this.ready;
    if (before) this.map.setFeatureState({ source: "tracks", id: before }, { chosen: false });
    const feature = this.tracks.get(id);
    if (!feature) return;
    this.map.setFeatureState({ source: "tracks", id }, { chosen: true });
    this.#fitTo(placesOf(feature));
  }

  fit() {
    const [west, south, east, north] = this.bounds ?? [];
    // Across the antimeridian west is the greater.
    const corners = this.bounds ? [[west, south], [east < west ? east + 360 : east, north]] : [...this.tracks.values()].flatMap(placesOf);
    this.#fitTo(corners);
  }

  #fitTo(places) {
    if (!places.length) return;
    const box = places.reduce((found, [lon, lat]) => found.extend([lon, lat]), new maplibregl.LngLatBounds());
    this.map.fitBounds(box, { padding: 60, maxZoom: 20, duration: 600 });
  }

  async visible(name, on) {
    await this.ready;
    const layers = name === "tracks" ? ["tracks-edge", "tracks"] : name in FEATURES ? Object.keys(FEATURES[name]) : [name];
    for (const id of layers) if (this.map.getLayer(id)) this.map.setLayoutProperty(id, "visibility", on ? "visible" : "none");
  }
}
