// Excluded areas, in which nothing is kept: hatched, so that an empty place is not taken for one where nobody drove.

import { colour } from "/static/map/style.js";

const EMPTY = { type: "FeatureCollection", features: [] };
const HATCH = "excluded-hatch";
const [SIDE, STROKE] = [10, 2]; // pixels
export const HATCHED = `repeating-linear-gradient(135deg, var(--quiet) 0 ${STROKE}px, transparent ${STROKE}px 5px)`;

// Lines from the lower left to the upper right, which go on in the next square.
function hatch() {
  const pen = new OffscreenCanvas(SIDE, SIDE).getContext("2d");
  Object.assign(pen, { strokeStyle: colour("--quiet"), lineWidth: STROKE });
  for (const from of [-SIDE, 0, SIDE]) {
    pen.moveTo(from - 1, SIDE + 1);
    pen.lineTo(from + SIDE + 1, -1);
  }
  pen.stroke();
  return pen.getImageData(0, 0, SIDE, SIDE);
}

export class Excluded {
  constructor(map) {
    Object.assign(this, { map, areas: EMPTY, asked: 0, beside: null, changed: () => {} });
  }

  addLayers() {
    this.map.addImage(HATCH, hatch());
    this.map.addSource("excluded", { type: "geojson", data: this.areas });
    this.map.addLayer({ id: "excluded", type: "fill", source: "excluded", paint: { "fill-pattern": HATCH } });
    this.map.addLayer({ id: "excluded-edge", type: "line", source: "excluded", paint: { "line-color": colour("--quiet"), "line-width": STROKE } });
  }

  // Asked for with each version, which a new area brings; one that has gone stays until the next one.
  async refresh(ask) {
    const mine = ++this.asked;
    const areas = await ask("/v1/excluded-areas").catch(() => null);
    if (areas && mine === this.asked) this.take(areas);
  }

  take(areas) {
    this.areas = areas;
    this.map.getSource("excluded")?.setData(areas);
    this.beside?.take(areas);
    this.changed();
  }

  recolour() {
    if (!this.map.getLayer("excluded")) return;
    this.map.updateImage(HATCH, hatch());
    this.map.setPaintProperty("excluded-edge", "line-color", colour("--quiet"));
  }
}
