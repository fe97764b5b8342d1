// The versions that are kept, on a slider; one of them beside another by the swipe.

import { element } from "/static/ui/dom.js";
import { Swipe } from "/static/map/swipe.js";

const when = (seconds) => new Date(1000 * seconds).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });

export class Versions {
  constructor(city, mapId, ask, changed) {
    Object.assign(this, { city, mapId, ask, changed, list: [] });
    this.swipe = new Swipe(city, () => changed(false));
    this.bar = element("div", "map-card");
    this.bar.id = "versions";
    this.bar.hidden = true;
    this.slider = Object.assign(element("input"), { type: "range", min: 0, step: 1, id: "version-slider", ariaLabel: "Version" });
    this.words = Object.assign(element("output"), { id: "version-words" });
    this.button = Object.assign(element("button", "", "Compare"), { type: "button", id: "compare", ariaPressed: "false" });
    this.other = Object.assign(element("select"), { id: "compare-with", ariaLabel: "Version to compare with", hidden: true });
    this.bar.append(this.slider, this.words, this.button, this.other);
    city.map.getContainer().append(this.bar);
    this.slider.addEventListener("input", () => this.#label(this.list[this.slider.value]));
    this.slider.addEventListener("change", () => this.choose(this.list[this.slider.value]?.version).then(() => changed(true)));
    this.button.addEventListener("click", () => this.compare(this.swipe.on ? null : this.#before()).then(() => changed(true)));
    this.other.addEventListener("change", () => this.compare(Number(this.other.value)).then(() => changed(true)));
    city.hear("version", () => this.refresh());
  }

  // Asked anew when something is published.
  async refresh() {
    const newest = this.city.newest?.version;
    if (!newest) return;
    if (this.list.at(-1)?.version !== newest) {
      const { versions } = await this.ask(`/v1/maps/${this.mapId}/versions`);
      this.list = versions.toReversed();
      this.other.replaceChildren(...this.list.map(({ version }) => Object.assign(element("option", "", `version ${version}`), { value: version })));
    }
    this.bar.hidden = this.list.length < 2;
    this.slider.max = this.list.length - 1;
    const row = this.list.findIndex(({ version }) => version === this.city.shown?.version);
    if (row >= 0) this.slider.value = row;
    this.#label(this.list[row]);
  }

  #label(version) {
    if (!version) return;
    const isNewest = version === this.list.at(-1);
    this.words.textContent = `version ${version.version}${isNewest ? ", newest" : ""} · ${when(version.created_at)}`;
    this.slider.ariaValueText = this.words.textContent;
  }

  #before() {
    const row = this.list.findIndex(({ version }) => version === this.city.shown?.version);
    return (this.list[row - 1] ?? this.list[row + 1])?.version ?? null;
  }

  // number: of a version; null or the newest's: whatever is the newest.
  async choose(number) {
    await this.refresh();
    const found = this.list.find(({ version }) => version === number);
    await this.city.pin(!found || found === this.list.at(-1) ? null : found);
  }

  // Beside another version; null: no more.
  async compare(number) {
    await this.refresh();
    const found = this.list.find(({ version }) => version === number);
    this.other.hidden = !found;
    this.button.ariaPressed = String(!!found);
    if (!found) return this.swipe.close();
    this.other.value = found.version;
    await this.swipe.show(found);
  }
}
