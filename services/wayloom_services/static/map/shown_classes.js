// Pictures of classes without those that are switched off: each pixel counts as the class whose colour is nearest, as small shares soften edges.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { send } from "/static/api.js";

const BITS = 5;
const SHIFT = 8 - BITS;
let palette = [];
let nearest = null;

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

// classes: those of /v1/info that are in the map.
export function knowClasses(classes) {
  palette = classes.map(({ id, colour }) => ({ id, tone: rgb(colour) }));
  nearest = null;
}

// The id of the class for each colour of five bits a channel.
function table() {
  if (nearest) return nearest;
  nearest = new Uint8Array(1 << (3 * BITS));
  for (let key = 0; key < nearest.length; key++) {
    const tone = [key >> (2 * BITS), (key >> BITS) & 31, key & 31].map((value) => (value << SHIFT) + (1 << (SHIFT - 1)));
    let least = Infinity;
    for (const { id, tone: own } of palette) {
      const apart = (tone[0] - own[0]) ** 2 + (tone[1] - own[1]) ** 2 + (tone[2] - own[2]) ** 2;
      if (apart < least) [least, nearest[key]] = [apart, id];
    }
  }
  return nearest;
}

// data: RGBA bytes, changed in place.
export function withoutClasses(data, hidden) {
  const classOf = table();
  for (let at = 0; at < data.length; at += 4) {
    if (data[at + 3] === 0) continue;
    const key = ((data[at] >> SHIFT) << (2 * BITS)) | ((data[at + 1] >> SHIFT) << BITS) | (data[at + 2] >> SHIFT);
    if (hidden.has(classOf[key])) data[at + 3] = 0;
  }
}

// `shown://3.7/https://…`: the picture behind the slash without classes 3 and 7.
maplibregl.addProtocol("shown", async ({ url }, { signal }) => {
  const [, ids, address] = url.match(/^shown:\/\/([0-9.]+)\/(.*)$/);
  const answer = await send(address, { signal });
  if (answer.status !== 200) return { data: null };
  const picture = await createImageBitmap(await answer.blob(), { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const canvas = new OffscreenCanvas(picture.width, picture.height);
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.drawImage(picture, 0, 0);
  const image = pen.getImageData(0, 0, picture.width, picture.height);
  withoutClasses(image.data, new Set(ids.split(".").map(Number)));
  pen.putImageData(image, 0, 0);
  return { data: await (await canvas.convertToBlob({ type: "image/png" })).arrayBuffer() };
});

export const addressWithout = (address, hidden) => (hidden.size ? `shown://${[...hidden].sort((a, b) => a - b).join(".")}/${address}` : address);
