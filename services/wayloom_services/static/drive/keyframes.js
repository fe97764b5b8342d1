// A drive's keyframes, scrubbed in time by a slider and keys: their image with labels while images are kept, else what the map has of them.

import { ask, send } from "/static/api.js";
import { at, element, say } from "/static/ui/dom.js";
import { many } from "/static/ui/words.js";

const WAIT_MS = 90;

const why = ({ images, retention }, may) => {
  if (images !== "kept") {
    const when = retention === "until-published" ? "after the drive was published" : `by the setting uploads.retention = ${retention}`;
    return `The images of this drive were deleted ${when}. Shown are the labelled points that the map has of this stretch, as the camera saw them. Send the same log once more (wayloom upload LOG --again) to have its images back.`;
  }
  return may ? "" : "Images are shown to operators. Shown are the labelled points that the map has of this stretch, as the camera saw them.";
};

export class Scrubber {
  // id: the drive's; operates: whether the caller sees images; here(t_s): called with the seconds from the first keyframe.
  constructor(id, operates, here) {
    Object.assign(this, { id, operates, here, list: [], timer: null, shown: null, asked: 0 });
    this.slider = at("keyframe");
    this.slider.addEventListener("input", () => this.#soon());
    at("labels").addEventListener("input", () => this.#soon());
    at("what").addEventListener("change", () => this.#soon());
    for (const [name, step] of [["earlier", -1], ["later", 1]]) at(name).addEventListener("click", () => this.#step(step));
  }

  async load() {
    const mine = ++this.asked;
    const found = await ask(`/v1/drives/${this.id}/keyframes`);
    if (mine !== this.asked) return;
    this.list = found.keyframes;
    at("keyframes").hidden = !this.list.length;
    if (!this.list.length) return;
    const withImages = found.images === "kept" && this.operates;
    say(at("no-image"), why(found, this.operates));
    at("image-tools").hidden = !withImages;
    if (!withImages) at("what").value = "points";
    this.slider.max = String(this.list.length - 1);
    this.slider.value = String(Math.floor(this.list.length / 2));
    await this.#show();
  }

  // Shows nothing more of what was asked for.
  stop() {
    this.asked++;
    clearTimeout(this.timer);
  }

  #step(by) {
    this.slider.value = String(Number(this.slider.value) + by);
    this.#show();
  }

  #soon() {
    this.#tell();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#show(), WAIT_MS);
  }

  #tell() {
    const one = this.list[Number(this.slider.value)];
    const seconds = one.t_s - this.list[0].t_s;
    const place = one.lon === null ? "" : `, ${one.lat.toFixed(6)}° ${one.lon.toFixed(6)}°`;
    const text = `Keyframe ${one.number + 1} of ${this.list.length}, frame ${one.frame}, ${seconds.toFixed(1)} s${place}, ${many(one.points, "point")}`;
    say(at("keyframe-words"), text);
    this.slider.setAttribute("aria-valuetext", text);
    this.here(seconds);
  }

  async #show() {
    this.#tell();
    const mine = ++this.asked;
    const words = at("keyframe-words").textContent;
    const number = Number(this.slider.value);
    const kind = at("what").value;
    const address = kind === "points" ? "points.webp" : `image.webp?labels=${at("labels").value}`;
    const answer = await send(`/v1/drives/${this.id}/keyframes/${number}/${address}`).catch(() => null);
    if (mine !== this.asked) return;
    if (!answer) return say(at("no-image"), "The service does not answer.");
    if (!answer.ok) {
      const { detail } = await answer.json().catch(() => ({}));
      if (mine !== this.asked) return;
      say(at("no-image"), detail ?? answer.statusText);
      if (kind === "points") return;
      at("what").value = "points";
      return this.#show();
    }
    const body = await answer.blob().catch(() => null);
    if (mine !== this.asked) return;
    if (!body) return say(at("no-image"), "The service does not answer.");
    const url = URL.createObjectURL(body);
    const image = element("img");
    image.src = url;
    image.alt = `${kind === "points" ? "Labelled points" : "Left image with labels and tracked points"} of ${words}`;
    await image.decode().catch(() => null);
    if (mine !== this.asked) return URL.revokeObjectURL(url);
    at("picture").replaceChildren(image);
    if (this.shown) URL.revokeObjectURL(this.shown);
    this.shown = url;
  }
}
