// Worker that hashes files: SHA-256 as hex. Small ones by the browser itself, large ones in pieces, so that none is held in memory whole.

import { sha256 } from "/static/vendor/noble-hashes/sha2.js";

const WHOLE = 16 * 2 ** 20;
const PIECE = 8 * 2 ** 20;
const hex = (bytes) => Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");

async function hashed(file, told) {
  if (file.size <= WHOLE && globalThis.crypto?.subtle) {
    const digest = await crypto.subtle.digest("SHA-256", await file.arrayBuffer());
    told(file.size);
    return hex(new Uint8Array(digest));
  }
  const running = sha256.create();
  for (let from = 0; from < file.size; from += PIECE) {
    const piece = new Uint8Array(await file.slice(from, from + PIECE).arrayBuffer());
    running.update(piece);
    told(piece.length);
  }
  return hex(running.digest());
}

addEventListener("message", async ({ data: { files } }) => {
  for (const [index, file] of files.entries()) {
    try {
      postMessage({ index, sha256: await hashed(file, (bytes) => postMessage({ bytes })) });
    } catch (error) {
      return postMessage({ index, error: error.message });
    }
  }
  postMessage({ done: true });
});
