// One drive on its way to the server: hashed, announced as `wayloom upload` announces it, and sent by tus where bytes are missing.
//
// It goes on after everything: a lost link, a pause, a reloaded page once the same folder is given again. The server says what it has.

import { ask, headers } from "/static/api.js";

const AT_ONCE = 4;
const CHUNK = 16 * 2 ** 20;
const PAUSES_MS = [0, 500, 1500, 4000, 8000, 15000];
const ROUNDS = 3;

let library = null;

// The vendored library is a classic script: it is loaded once, when the first drive is sent.
function tus() {
  library ??= new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = "/static/vendor/tus-js-client/tus.min.js";
    script.addEventListener("load", () => resolve(globalThis.tus));
    script.addEventListener("error", () => reject(new Error("the upload library does not load")));
    document.head.append(script);
  });
  return library;
}

// A browser does not give a file that has been changed since it was chosen.
async function legible(path, file) {
  try {
    await file.slice(0, 1).arrayBuffer();
  } catch {
    throw new Error(`${path} has changed on this disk since it was read, or is gone: give the folder again`);
  }
}

export class Sender {
  // drive: of `drivesOf`, with vehicle; changed(): called after every change of what is shown of it.
  constructor(drive, changed) {
    Object.assign(this, { drive, changed, state: "hashing", error: "", read: 0, arrived: 0, filesDone: 0, id: null });
    this.active = new Map();
    this.worker = null;
  }

  get total() {
    return this.drive.bytes;
  }

  // Bytes that the server has, as far as this page knows.
  get sent() {
    return this.arrived + [...this.active.values()].reduce((sum, { bytes }) => sum + bytes, 0);
  }

  // Reads what is not read yet, asks what the server has, and sends the rest.
  async run() {
    try {
      await this.#hash();
      await this.#send();
    } catch (error) {
      await this.#fail(error);
    }
  }

  // As `run`, of the files as they are now: those that have changed since are read anew, and the drive is announced with them.
  async resume() {
    this.#to("hashing");
    try {
      await this.#renew();
    } catch (error) {
      return this.#fail(error);
    }
    await this.run();
  }

  async #renew() {
    for (const one of this.drive.files) {
      const file = (await one.renew?.()) ?? one.file;
      if (file.size === one.file.size && file.lastModified === one.file.lastModified) continue;
      this.drive.bytes += file.size - one.file.size;
      Object.assign(one, { file, sha256: null });
    }
    this.read = this.drive.files.reduce((sum, { file, sha256 }) => sum + (sha256 ? file.size : 0), 0);
  }

  #to(state, error = "") {
    if (this.state === "cancelled") return;
    Object.assign(this, { state, error });
    this.changed();
  }

  async #fail(error) {
    if (["paused", "cancelled"].includes(this.state)) return;
    await this.#halt("stopped");
    this.#to("stopped", error.message);
  }

  async #hash() {
    const wanted = this.drive.files.filter(({ sha256 }) => !sha256);
    if (!wanted.length) return;
    this.worker = new Worker(new URL("./hasher.js", import.meta.url), { type: "module" });
    try {
      await this.#hashed(wanted);
    } finally {
      this.worker.terminate();
      this.worker = null;
    }
  }

  #hashed(wanted) {
    return new Promise((resolve, reject) => {
      for (const name of ["error", "messageerror"]) {
        this.worker.addEventListener(name, () => reject(new Error("the files cannot be hashed in this browser")));
      }
      this.worker.addEventListener("message", ({ data }) => {
        if (data.bytes) this.read += data.bytes;
        if (data.sha256) wanted[data.index].sha256 = data.sha256;
        if (data.error) reject(new Error(`${wanted[data.index].path} cannot be read: ${data.error}`));
        this.changed();
        if (data.done) resolve();
      });
      this.worker.postMessage({ files: wanted.map(({ file }) => file) });
    });
  }

  get #manifest() {
    const { name, vehicle, log, gnss, files } = this.drive;
    const listed = files.map(({ path, file, sha256 }) => ({ path, size: file.size, sha256 }));
    return JSON.stringify({ name, ...(vehicle ? { vehicle_id: vehicle } : {}), log, ...(gnss ? { gnss } : {}), files: listed });
  }

  async #send() {
    await tus();
    for (let round = 0; round < ROUNDS; round++) {
      this.#to("announcing");
      const { id, missing, drive } = await ask("/v1/drives", { method: "POST", body: this.#manifest });
      this.id = id;
      this.filesDone = this.drive.files.length - missing.length;
      this.arrived = this.total - missing.reduce((sum, { size }) => sum + size, 0);
      if (!missing.length) return this.#to(drive.state === "uploading" ? "stopped" : "sent");
      this.#to("sending");
      await this.#sendFiles(missing);
      if (this.state !== "sending") return;
    }
    throw new Error("some files did not arrive whole: check the disk they are on, and send them again");
  }

  async #sendFiles(missing) {
    const sources = new Map(this.drive.files.map(({ path, file }) => [path, file]));
    const waiting = [...missing].reverse();
    const lane = async () => {
      while (waiting.length && this.state === "sending") {
        const one = waiting.pop();
        await legible(one.path, sources.get(one.path));
        if (this.state === "sending") await this.#sendFile(one, sources.get(one.path));
      }
    };
    await Promise.all(Array.from({ length: AT_ONCE }, lane));
  }

  #sendFile({ path, upload: address, offset }, file) {
    return new Promise((resolve, reject) => {
      const progress = { bytes: offset, upload: null, resolve };
      const upload = new globalThis.tus.Upload(file, {
        endpoint: "/v1/uploads", ...(address ? { uploadUrl: new URL(address, location.origin).href } : {}),
        metadata: { drive: this.id, path }, headers: headers(), chunkSize: CHUNK, retryDelays: PAUSES_MS, uploadDataDuringCreation: true,
        storeFingerprintForResuming: false,
        onProgress: (bytes) => {
          progress.bytes = bytes;
          this.changed();
        },
        onSuccess: () => {
          this.active.delete(path);
          this.arrived += file.size;
          this.filesDone += 1;
          this.changed();
          resolve();
        },
        onError: (error) => {
          this.active.delete(path);
          legible(path, file).then(() => reject(new Error(error.originalResponse ? error.message : "the link is down")), reject);
        },
      });
      progress.upload = upload;
      this.active.set(path, progress);
      upload.start();
    });
  }

  async #halt(state) {
    this.#to(state);
    const held = [...this.active.values()];
    this.active.clear();
    await Promise.all(held.map(({ upload }) => upload.abort().catch(() => null)));
    for (const { resolve } of held) resolve();
  }

  pause() {
    return this.#halt("paused");
  }

  // What has arrived stays on the server until its time is over; the same folder given again goes on there.
  async cancel() {
    this.worker?.terminate();
    await this.#halt("cancelled");
    this.changed();
  }
}
