// What is missing of a drive, in the streams that it is sent in: small files in packs, one behind the other, and the others by themselves.

import { ask } from "/static/api.js";

const LARGEST_PACKED = 4 * 2 ** 20; // the server takes no larger file in a pack
const LARGEST_PACK = 10_000;
const LEAST_PACK = 500;
const PACKS = 2;

// A browser does not give a file that has been changed since it was chosen.
async function legible({ path, file }) {
  try {
    await file.slice(0, 1).arrayBuffer();
  } catch {
    throw new Error(`${path} has changed on this disk since it was read, or is gone: give the folder again`);
  }
}

// One tus upload. files: [{ path, file }], in the order of their bytes; known, before: bytes and files of them that are counted elsewhere.
class Stream {
  constructor(drive, files, { address = null, offset = 0, known = 0, before = 0 } = {}) {
    Object.assign(this, { drive, address, known, before, bytes: Math.max(offset, known), upload: null, resolve: null });
    this.hold(files);
  }

  hold(files) {
    this.files = files;
    this.whole = 0;
    this.ends = [];
    this.total = files.reduce((sum, { file }) => (this.ends.push(sum + file.size), sum + file.size), 0);
  }

  // Bytes and files that have gone with it and are counted nowhere else.
  get sent() {
    return this.bytes - this.known;
  }

  get filesDone() {
    while (this.whole && this.ends[this.whole - 1] > this.bytes) this.whole -= 1;
    while (this.whole < this.ends.length && this.ends[this.whole] <= this.bytes) this.whole += 1;
    return this.whole - this.before;
  }

  async check() {
    for (const one of this.files) await legible(one);
  }
}

class Alone extends Stream {
  get source() {
    return this.files[0].file;
  }

  get metadata() {
    return { drive: this.drive, path: this.files[0].path };
  }

  async begin() {
    return [];
  }
}

class Pack extends Stream {
  get source() {
    return new Blob(this.files.map(({ file }) => file));
  }

  // It is created by `begin`, not by the library.
  get metadata() {
    return null;
  }

  // Announces it. What has arrived since it was made is left out of it and given back; without an address there is nothing left.
  async begin() {
    if (this.address) return [];
    const paths = this.files.map(({ path }) => path);
    const { upload, skipped } = await ask(`/v1/drives/${this.drive}/packs`, { method: "POST", body: JSON.stringify({ paths }) });
    const arrived = new Set(skipped);
    const here = this.files.filter(({ path }) => arrived.has(path));
    this.hold(this.files.filter(({ path }) => !arrived.has(path)));
    this.address = upload;
    return here;
  }
}

// A pack that was begun earlier, null where nothing of it is missing or the server has lost it. Its files are taken out of `missing`.
async function continued(drive, address, sources, missing) {
  const { files } = await ask(`${address}/files`).catch(() => ({ files: [] }));
  if (!files.some(({ path }) => missing.has(path))) return null;
  const arrived = files.filter(({ path }) => !missing.delete(path));
  const known = arrived.reduce((sum, { size }) => sum + size, 0);
  return new Pack(drive, files.map(({ path }) => ({ path, file: sources.get(path) })), { address, known, before: arrived.length });
}

// Streams of what a drive's registration calls missing: packs that were begun first. sources: path → File.
export async function streamsOf({ id, missing: wanted, packs }, sources) {
  const missing = new Map(wanted.map((one) => [one.path, one]));
  const streams = [];
  for (const { upload } of packs) {
    const pack = await continued(id, upload, sources, missing);
    if (pack) streams.push(pack);
  }
  const small = [...missing.values()].filter(({ size, upload }) => size <= LARGEST_PACKED && !upload);
  if (small.length > 1) {
    const each = Math.min(LARGEST_PACK, Math.max(LEAST_PACK, Math.ceil(small.length / PACKS)));
    for (let start = 0; start < small.length; start += each) {
      streams.push(new Pack(id, small.slice(start, start + each).map(({ path }) => ({ path, file: sources.get(path) }))));
    }
    for (const { path } of small) missing.delete(path);
  }
  for (const { path, upload, offset } of missing.values()) {
    streams.push(new Alone(id, [{ path, file: sources.get(path) }], { address: upload, offset }));
  }
  return streams;
}
