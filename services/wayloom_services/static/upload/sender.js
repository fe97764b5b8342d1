// One drive on its way to the server: hashed, announced as `wayloom upload` announces it, and sent by tus where bytes are missing.
//
// It goes on after everything: a lost link, a pause, a reloaded page once the same folder is given again. The server says what it has.

import { ask, headers } from "/static/api.js";
import { streamsOf } from "/static/upload/streams.js";

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

// What the server says of a refusal, or what the library makes of it.
function reasonOf(error) {
  if (!error.originalResponse) return "the link is down";
  try {
    return JSON.parse(error.originalResponse.getBody()).detail ?? error.message;
  } catch {
    return error.message;
  }
}

export class Sender {
  // drive: of `drivesOf`, with vehicle; changed(): called after every change of what is shown of it.
  constructor(drive, changed) {
    Object.assign(this, { drive, changed, state: "hashing", error: "", read: 0, arrived: 0, filesArrived: 0 });
    this.active = new Set();
    this.worker = null;
  }

  get total() {
    return this.drive.bytes;
  }

  // Bytes that the server has, as far as this page knows.
  get sent() {
    return this.arrived + [...this.active].reduce((sum, { sent }) => sum + sent, 0);
  }

  get filesDone() {
    return this.filesArrived + [...this.active].reduce((sum, { filesDone }) => sum + filesDone, 0);
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
      const registration = await ask("/v1/drives", { method: "POST", body: this.#manifest });
      const { missing, drive } = registration;
      this.filesArrived = this.drive.files.length - missing.length;
      this.arrived = this.total - missing.reduce((sum, { size }) => sum + size, 0);
      if (!missing.length) return this.#to(drive.state === "uploading" ? "stopped" : "sent");
      this.#to("sending");
      await this.#sendStreams(await streamsOf(registration, new Map(this.drive.files.map(({ path, file }) => [path, file]))));
      if (this.state !== "sending") return;
    }
    throw new Error("some files did not arrive whole: check the disk they are on, and send them again");
  }

  async #sendStreams(streams) {
    const waiting = streams.reverse();
    const lane = async () => {
      while (waiting.length && this.state === "sending") await this.#sendStream(waiting.pop());
    };
    await Promise.all(Array.from({ length: AT_ONCE }, lane));
  }

  async #sendStream(stream) {
    await stream.check();
    for (const { file } of await stream.begin()) this.#count(file.size, 1);
    if (!stream.files.length || this.state !== "sending") return;
    await this.#sendBytes(stream);
  }

  #count(bytes, files) {
    this.arrived += bytes;
    this.filesArrived += files;
    this.changed();
  }

  #sendBytes(stream) {
    return new Promise((resolve, reject) => {
      const { address, metadata, source } = stream;
      const upload = new globalThis.tus.Upload(source, {
        ...(metadata ? { endpoint: "/v1/uploads", metadata } : {}),
        ...(address ? { uploadUrl: new URL(address, location.origin).href } : {}), headers: headers(), chunkSize: CHUNK,
        retryDelays: PAUSES_MS, uploadDataDuringCreation: true, storeFingerprintForResuming: false,
        onProgress: (bytes) => {
          stream.bytes = bytes;
          this.changed();
        },
        onSuccess: () => {
          stream.bytes = stream.total;
          this.active.delete(stream);
          this.#count(stream.sent, stream.filesDone);
          resolve();
        },
        onError: (error) => {
          this.active.delete(stream);
          stream.check().then(() => reject(new Error(reasonOf(error))), reject);
        },
      });
      Object.assign(stream, { upload, resolve });
      this.active.add(stream);
      upload.start();
    });
  }

  async #halt(state) {
    this.#to(state);
    const held = [...this.active];
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
