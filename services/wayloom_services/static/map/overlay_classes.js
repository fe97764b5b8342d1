// Classes in the pictures of overlays, noted as the pictures come: no vector tiles tell of them.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";

const noted = new Map(); // names of classes by address
let nameOf = new Map();

// classes: all of /v1/info.
export function noteClasses(classes) {
  nameOf = new Map(classes.map(({ name, colour }) => [parseInt(colour.slice(1), 16), name]));
}

function namesIn(data) {
  const found = new Set();
  for (let at = 0; at < data.length; at += 4) {
    if (data[at + 3] === 255) found.add(nameOf.get((data[at] << 16) | (data[at + 1] << 8) | data[at + 2]));
  }
  found.delete(undefined); // edges, which are softened
  return found;
}

// data: RGBA bytes of the picture as it was sent.
export function note(address, data) {
  if (!noted.has(address)) noted.set(address, namesIn(data));
}

const unitOf = (place) => maplibregl.MercatorCoordinate.fromLngLat(place);

// Names of the classes in pictures at `base/z/x/y.png` that touch the bounds of a view.
export function namesWithin(base, bounds) {
  const [low, high] = [unitOf(bounds.getNorthWest()), unitOf(bounds.getSouthEast())];
  const isInSight = (z, x, y) => x + 1 > low.x * 2 ** z && x < high.x * 2 ** z && y + 1 > low.y * 2 ** z && y < high.y * 2 ** z;
  const found = new Set();
  for (const [address, names] of noted) {
    if (!address.startsWith(`${base}/`)) continue;
    const [z, x, y] = address.slice(base.length + 1).split("/").map((part) => parseInt(part, 10));
    if (isInSight(z, x, y)) names.forEach((name) => found.add(name));
  }
  return found;
}
