// Pictures of classes as MapLibre gets them: in the colours of the page's ground, without classes that are switched off.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { send } from "/static/api.js";
import { ClassPixels, pixelsOf } from "/static/map/class_pixels.js";
import { note } from "/static/map/overlay_classes.js";
import { scheme } from "/static/ui/tones.js";

const NOTHING = new Set();
let [ofMap, ofOverlays] = [null, null];

// classes: all of /v1/info.
export function knowClasses(classes) {
  ofMap = new ClassPixels(classes.filter((one) => one.in_map));
  ofOverlays = new ClassPixels(classes);
}

// `classes://dark/3.7/https://…`: the picture behind it on dark ground without classes 3 and 7; `classes://dark/overlay/https://…`: that of an overlay.
maplibregl.addProtocol("classes", async ({ url }, { signal }) => {
  const [, on, ids, address] = url.match(/^classes:\/\/(\w+)\/([0-9.]*|overlay)\/(.*)$/);
  const answer = await send(address, { signal });
  if (answer.status !== 200) return { data: null };
  const pixels = await pixelsOf(await answer.blob());
  if (ids === "overlay") {
    note(address, pixels.data);
    ofOverlays.draw(pixels.data, on, NOTHING);
  } else {
    ofMap.draw(pixels.data, on, new Set(ids.split(".").filter(Boolean).map(Number)));
  }
  return { data: await createImageBitmap(pixels) };
});

export const addressWithout = (address, hidden) => `classes://${scheme()}/${[...hidden].sort((a, b) => a - b).join(".")}/${address}`;
export const overlayAddress = (address) => `classes://${scheme()}/overlay/${address}`;
