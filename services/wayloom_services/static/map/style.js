// How the map is drawn: its grid, its vector layers, its ramps and palettes.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { tone } from "/static/ui/tones.js";

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

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

export const grid = () => ({ type: "raster", tiles: ["grid://{z}/{x}/{y}"], tileSize: 256, maxzoom: 22 });

// For the page's light or dark scheme.
export function renewGrid(map) {
  map.removeLayer("grid");
  map.removeSource("grid");
  map.addSource("grid", grid());
  map.addLayer({ id: "grid", type: "raster", source: "grid" }, map.getStyle().layers[0]?.id);
}

// Kinds of features by the class of the legend that shows and hides them.
export const KIND_OF_CLASS = {
  road: "road", sidewalk: "sidewalk", terrain: "terrain", pole: "pole", "traffic sign": "traffic_sign", "traffic light": "traffic_light", vegetation: "trunk",
};

// Vector tiles of features by their names: the layers within a tile, and how they are drawn, over the photograph and the classes.
export const FEATURES = {
  areas: {
    areas: {
      type: "fill", minzoom: 15,
      paint: { "fill-opacity": 0.35, "fill-antialias": false },
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
        "circle-radius": ["interpolate", ["linear"], ["zoom"], 16, 2.5, 21, 7],
        "circle-stroke-color": "#2b353c", "circle-stroke-width": 1.2, // they lie on pixels of their class
      },
    },
  },
};

// What classes' colours paint of these, on the ground of the page's scheme.
const byKind = (colours, otherwise) => ["match", ["get", "kind"], ...Object.entries(colours).flatMap(([kind, own]) => [kind, tone(own)]), tone(otherwise)];
const CLASS_PAINT = {
  areas: () => ({ "fill-color": byKind({ road: "#804080", sidewalk: "#f423e8" }, "#98fb98") }),
  objects: () => ({ "circle-color": byKind({ pole: "#999999", traffic_sign: "#dcdc00", traffic_light: "#faaa1e" }, "#6b8e23") }),
};
export const classPaint = (id) => CLASS_PAINT[id]?.() ?? {};
export const HIDDEN = new Set(["areas"]);

// Even in lightness: from few to many, and from old to new.
export const COUNT_RAMP = ["#440154", "#365c8d", "#1fa187", "#a0da39", "#fde725"];
export const AGE_RAMP = ["#123570", "#5c616e", "#9b9476", "#dcc85a", "#fee838"];
// Okabe and Ito's, which people with any colour vision tell apart.
export const PALETTE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#6a3d9a"];
export const CHANGES = { new: "#1a7f4f", gone: "#b3372f" };
export const GRADES = { A: "#1a7f4f", B: "#6aa84f", C: "#d0a215", D: "#d9702b", E: "#b3372f" };

// A MapLibre expression over a ramp between two values of a number.
export const ramped = (value, [low, high], ramp) => ["interpolate", ["linear"], value, ...ramp.flatMap((tone, step) => [low + ((high - low) * step) / (ramp.length - 1), tone])];
