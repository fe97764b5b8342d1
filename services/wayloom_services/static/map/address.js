// The map's view in the page's address: place, layers, classes, colours, version, swipe, drive and what is told of.

import { numbersOf, readHash, writeHash } from "/static/map/hash.js";

const WRITE_AFTER_MS = 300;

export class Address {
  constructor({ city, at, legend, versions, told }) {
    Object.assign(this, { city, at, legend, versions, told, quiet: true, timer: 0 });
  }

  #boxes() {
    return [...document.querySelectorAll("input[id^='show-']")];
  }

  words() {
    const { lng, lat } = this.city.map.getCenter();
    const named = (boxes) => boxes.map(({ id }) => id.slice("show-".length)).join(",");
    const { swipe } = this.versions;
    return {
      at: [lng.toFixed(7), lat.toFixed(7), this.city.map.getZoom().toFixed(2)].join(","),
      on: named(this.#boxes().filter((box) => box.checked && !box.defaultChecked)),
      off: named(this.#boxes().filter((box) => !box.checked && box.defaultChecked)),
      hide: [...this.legend.hidden].sort().join(","),
      tracks: this.city.tracks.mode === "plain" ? "" : this.city.tracks.mode,
      coverage: this.city.coverage.mode === "plain" ? "" : this.city.coverage.mode,
      v: this.city.pinned?.version, swipe: swipe.on ? `${swipe.version.version},${swipe.share.toFixed(2)}` : "",
      drive: this.city.chosen, told: this.told.place?.map((value) => value.toFixed(7)).join(","),
    };
  }

  // step: a choice to which the back button comes back.
  keep(step = false) {
    if (this.quiet) return;
    clearTimeout(this.timer);
    if (step) writeHash(this.words(), true);
    else this.timer = setTimeout(() => writeHash(this.words()), WRITE_AFTER_MS);
  }

  // Whether the address names a place.
  get isPlaced() {
    return numbersOf(readHash().get("at"), 3) !== null;
  }

  // The view that the address names. first: when the page is opened, a drive that was chosen meanwhile stays where the address names none.
  async restore(first = false) {
    const words = readHash();
    const list = (name) => new Set((words.get(name) ?? "").split(",").filter(Boolean));
    this.quiet = true;
    const place = numbersOf(words.get("at"), 3);
    if (place) this.city.map.jumpTo({ center: place.slice(0, 2), zoom: place[2] });
    const [on, off] = [list("on"), list("off")];
    for (const box of this.#boxes()) {
      const name = box.id.slice("show-".length);
      const wanted = on.has(name) || (box.defaultChecked && !off.has(name));
      if (box.checked !== wanted) {
        box.checked = wanted;
        box.dispatchEvent(new Event("change"));
      }
    }
    await this.city.ready;
    this.legend.hide(list("hide"));
    this.legend.choose({ tracks: words.get("tracks") ?? "plain", coverage: words.get("coverage") ?? "plain" });
    await this.#restoreVersion(words);
    const drive = words.get("drive");
    if (drive !== this.city.chosen && (drive || !first)) await this.city.choose(drive, false);
    const told = numbersOf(words.get("told"), 2);
    if (told) this.told.tellOf(told, this.city.map.project(told));
    else this.told.close();
    this.quiet = false;
  }

  async #restoreVersion(words) {
    if (!this.city.newest) return;
    const wanted = Number(words.get("v")) || null;
    if ((this.city.pinned?.version ?? null) !== wanted) await this.versions.choose(wanted);
    const swipe = numbersOf(words.get("swipe"), 2);
    if (swipe) this.versions.swipe.move(swipe[1]);
    if ((this.versions.swipe.version?.version ?? null) !== (swipe?.[0] ?? null)) await this.versions.compare(swipe?.[0] ?? null);
  }
}
