// The legend: classes that are there, each switched on and off; what the colours of tracks, coverage, overlays and lines mean.

import { element } from "/static/ui/dom.js";
import { HATCHED } from "/static/map/excluded.js";
import { AGE_RAMP, CHANGES, COUNT_RAMP, FEATURES } from "/static/map/style.js";
import { onGround } from "/static/ui/tones.js";
import { many } from "/static/ui/words.js";

const day = (seconds) => new Date(1000 * seconds).toISOString().slice(0, 10);
const LINES = ["markings", "kerbs"];
const CHOICES = {
  tracks: { plain: "one colour", vehicle: "vehicle", age: "age", grade: "grade" },
  coverage: { plain: "one colour", drives: "number of drives", age: "last drive" },
};

export class Legend {
  // into: the page's <details>. changed(step): what is chosen here has changed.
  constructor(into, city, { classes, overlays }, changed) {
    Object.assign(this, { into, city, all: classes, overlays, changed, hidden: new Set(), listed: "" });
    this.classes = classes.filter((one) => one.in_map);
    this.list = into.querySelector("ul");
    into.querySelector("summary").textContent = "Legend";
    this.tracks = this.#choice("tracks", "Tracks by", (mode) => city.tracks.by(mode));
    this.coverage = this.#choice("coverage", "Coverage by", (mode) => this.#cover(mode));
    city.hear("tracks", () => this.#showTracks());
    city.coverage.changed = () => this.#showCoverage();
    this.also = element("div", "also");
    into.append(this.also);
    city.map.on("idle", () => (this.#listClasses(), this.#listAlso()));
    this.#fill(this.classes);
    this.#showTracks();
  }

  #choice(name, words, work) {
    const [section, label, choice, meaning] = [element("div", "by"), element("label"), element("select"), element("div", "meaning")];
    choice.id = `${name}-by`;
    choice.append(...Object.entries(CHOICES[name]).map(([value, text]) => Object.assign(element("option", "", text), { value })));
    choice.addEventListener("change", () => (work(choice.value), this.changed(true)));
    label.append(element("span", "quiet", words), choice);
    section.append(label, meaning);
    this.into.append(section);
    return { choice, meaning };
  }

  // Who asks for a colour of coverage wants to see it.
  async #cover(mode) {
    const box = document.getElementById("show-coverage");
    if (mode !== "plain" && box && !box.checked) box.click();
    await this.city.coverage.by(mode);
  }

  #listClasses() {
    const names = this.city.layers.classesHere();
    if (names) this.#fill(this.classes.filter(({ name }) => names.has(name) || this.hidden.has(name)));
  }

  // Of overlays, lines, changes and excluded areas that are in sight.
  #listAlso() {
    const groups = this.overlays.map((name) => [name, this.#overlay(name)]);
    groups.push(["lines", this.#lines()], ["changes", this.#changes()], ["privacy", this.#excluded()]);
    const shown = groups.filter(([, entries]) => entries.length);
    const key = JSON.stringify(shown);
    if (key === this.also.dataset.key) return;
    this.also.dataset.key = key;
    this.also.replaceChildren(...shown.map(([name, entries]) => group(name, entries)));
  }

  #overlay(name) {
    const names = this.city.layers.classesOf(name);
    return this.all.filter((one) => names.has(one.name)).map((one) => [one.name, onGround(one.colour)]);
  }

  #drawn(id) {
    return this.city.map.getLayer(id) ? this.city.map.queryRenderedFeatures({ layers: [id] }) : [];
  }

  #lines() {
    const { layers, map, shown } = this.city;
    const comeNearer = shown?.layers.markings && !layers.off.has("markings") && map.getZoom() < FEATURES.markings.markings.minzoom;
    if (comeNearer) return [["come nearer for markings and kerbs", "transparent"]];
    return LINES.filter((id) => this.#drawn(id).length).map((id) => [id, FEATURES.markings[id].paint["line-color"]]);
  }

  #changes() {
    const kinds = new Set(this.#drawn("changes").map(({ properties }) => (properties.kind === "gone" ? "gone" : "new")));
    return [["is new", "new"], ["has gone", "gone"]].filter(([, kind]) => kinds.has(kind)).map(([words, kind]) => [words, CHANGES[kind]]);
  }

  #excluded() {
    return this.#drawn("excluded").length ? [["excluded area", HATCHED]] : [];
  }

  #fill(classes) {
    const key = classes.map(({ name }) => name).join();
    if (key === this.listed) return;
    this.listed = key;
    this.list.replaceChildren(...classes.map((one) => this.#entry(one)));
  }

  #entry({ name, colour }) {
    const [item, label, box, square] = [element("li"), element("label"), element("input"), element("i")];
    Object.assign(box, { type: "checkbox", value: name, checked: !this.hidden.has(name) });
    box.addEventListener("change", () => {
      if (box.checked) this.hidden.delete(name);
      else this.hidden.add(name);
      this.hide(this.hidden);
      this.changed(true);
    });
    square.style.background = onGround(colour);
    label.append(box, square, name);
    item.append(label);
    return item;
  }

  // names: a Set of those that are not drawn.
  hide(names) {
    this.hidden = names;
    for (const box of this.list.querySelectorAll("input")) box.checked = !names.has(box.value);
    const classes = this.classes.filter(({ name }) => names.has(name));
    this.city.layers.hide(classes);
    this.city.other?.hide(classes);
  }

  // By the page's address.
  choose({ tracks = "plain", coverage = "plain" }) {
    this.tracks.choice.value = tracks in CHOICES.tracks ? tracks : "plain";
    this.coverage.choice.value = coverage in CHOICES.coverage ? coverage : "plain";
    if (this.city.tracks.mode !== this.tracks.choice.value) this.city.tracks.by(this.tracks.choice.value);
    if (this.city.coverage.mode !== this.coverage.choice.value) this.#cover(this.coverage.choice.value);
  }

  #showTracks() {
    const { mode } = this.city.tracks;
    const ages = mode === "age" ? ramp(AGE_RAMP, this.city.tracks.ages().map(day)) : [];
    this.tracks.meaning.replaceChildren(...ages, ...keys(this.city.tracks.legend()));
  }

  #showCoverage() {
    const { mode } = this.city.coverage;
    const [low, high] = this.city.coverage.range();
    const count = (value) => many(Math.round(value), "drive");
    const shown = { plain: () => [], drives: () => ramp(COUNT_RAMP, [count(low), count(high)]), age: () => ramp(AGE_RAMP, [day(low), day(high)]) };
    this.coverage.meaning.replaceChildren(...shown[mode]());
  }
}

// A bar of the ramp's colours, and the words at its ends.
function ramp(colours, [low, high]) {
  const bar = element("span", "ramp");
  bar.style.background = `linear-gradient(to right, ${colours.join(", ")})`;
  return [bar, element("span", "quiet", low), element("span", "quiet end", high)];
}

// entries: [[words, colour]].
function keys(entries) {
  return entries.map(([words, tone]) => {
    const [entry, square] = [element("span", "key"), element("i")];
    square.style.background = tone;
    entry.append(square, words);
    return entry;
  });
}

function group(name, entries) {
  const [section, meaning] = [element("div", "by"), element("div", "meaning")];
  section.dataset.of = name;
  meaning.append(...keys(entries));
  section.append(element("span", "quiet", `${name[0].toUpperCase()}${name.slice(1)}`), meaning);
  return section;
}
