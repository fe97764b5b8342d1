// Pictures of classes in the colours of the page's ground, without classes that are switched off.
// Each pixel counts as the class whose colour is nearest, as small shares soften edges.

import { bytesOf, tone } from "/static/ui/tones.js";

const BITS = 5;
const SHIFT = 8 - BITS;

export class ClassPixels {
  // classes: those of /v1/info that may be in the pictures.
  constructor(classes) {
    this.classes = classes;
    this.nearest = null;
    this.moved = new Map();
  }

  // The row of the class for each colour of five bits a channel.
  #table() {
    if (this.nearest) return this.nearest;
    const tones = this.classes.map(({ colour }) => bytesOf(colour));
    this.nearest = new Uint8Array(1 << (3 * BITS));
    for (let key = 0; key < this.nearest.length; key++) {
      const [red, green, blue] = [key >> (2 * BITS), (key >> BITS) & 31, key & 31].map((value) => (value << SHIFT) + (1 << (SHIFT - 1)));
      let least = Infinity;
      for (let row = 0; row < tones.length; row++) {
        const apart = (red - tones[row][0]) ** 2 + (green - tones[row][1]) ** 2 + (blue - tones[row][2]) ** 2;
        if (apart < least) [least, this.nearest[key]] = [apart, row];
      }
    }
    return this.nearest;
  }

  // By how much each class's colour moves on the ground of a scheme, three numbers a row.
  #moves(on) {
    if (!this.moved.has(on)) this.moved.set(on, Int16Array.from(this.classes.flatMap(({ colour }) => bytesOf(tone(colour, on)).map((value, k) => value - bytesOf(colour)[k]))));
    return this.moved.get(on);
  }

  // data: RGBA bytes, clamped, changed in place: softened edges stay soft, as each pixel moves by as much as its class. hidden: a Set of ids.
  draw(data, on, hidden) {
    const [rowOf, moves] = [this.#table(), this.#moves(on)];
    const isHidden = this.classes.map(({ id }) => hidden.has(id));
    for (let at = 0; at < data.length; at += 4) {
      if (data[at + 3] === 0) continue;
      const row = rowOf[((data[at] >> SHIFT) << (2 * BITS)) | ((data[at + 1] >> SHIFT) << BITS) | (data[at + 2] >> SHIFT)];
      if (isHidden[row]) data[at + 3] = 0;
      for (let k = 0; k < 3; k++) data[at + k] += moves[3 * row + k];
    }
  }
}

// A picture's ImageData. blob: of an encoded image.
export async function pixelsOf(blob) {
  const picture = await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const pen = new OffscreenCanvas(picture.width, picture.height).getContext("2d", { willReadFrequently: true });
  pen.drawImage(picture, 0, 0);
  picture.close();
  return pen.getImageData(0, 0, pen.canvas.width, pen.canvas.height);
}
