// Sites that are far apart: from afar, marks with how many drives there are; insets and a list to jump to each.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { element } from "/static/ui/dom.js";
import { Insets } from "/static/map/insets.js";
import { areaOf, joined, middleOf, sitesOf } from "/static/map/sites.js";
import { placesOf } from "/static/map/tracks.js";
import { many } from "/static/ui/words.js";

const SPECK_PX = 70;
const TOGETHER_PX = 56;

const wasIn = (feature, [west, south, east, north]) => placesOf(feature).some(([lon, lat]) => lon >= west && lon <= east && lat >= south && lat <= north);

export class Sites {
  constructor(city, list) {
    Object.assign(this, { city, map: city.map, list, sites: [], marks: [], counted: null });
    this.insets = new Insets(city.map.getContainer(), (bounds) => this.#jump(bounds));
    city.coverage.known = (features) => this.#know(sitesOf(features));
    this.map.on("moveend", () => this.draw());
    city.hear("tracks", () => this.#count());
    if (city.coverage.streets.features.length) this.#know(sitesOf(city.coverage.streets.features));
  }

  #know(sites) {
    this.sites = sites;
    this.counted = null;
    this.#count();
  }

  // The drives of each site, anew when one has come or gone.
  #count() {
    const { features } = this.city.tracks;
    const key = features.map(({ properties: { id } }) => id).join();
    if (key === this.counted) return;
    this.counted = key;
    for (const site of this.sites) site.tracks = features.filter((one) => wasIn(one, site.bounds));
    this.#show(this.sites);
  }

  #show(sites) {
    this.list.fill("sites", "Sites", sites.length < 2 ? [] : sites.map((site, number) => ({
      title: `Site ${number + 1}`, words: `${many(site.tracks.length, "drive")} · ${(areaOf(site.bounds) / 1e6).toFixed(2)} km²`, work: () => this.#jump(site.bounds),
    })));
    this.insets.show(sites);
    this.draw();
  }

  #jump([west, south, east, north]) {
    this.city.fitTo([[west, south], [east, north]]);
  }

  #pixels([west, south, east, north]) {
    const [a, b] = [this.map.project([west, north]), this.map.project([east, south])];
    return Math.max(b.x - a.x, b.y - a.y);
  }

  // Groups of specks that would lie over each other.
  #groups() {
    const groups = [];
    for (const site of this.sites.filter(({ bounds }) => this.#pixels(bounds) < SPECK_PX)) {
      const at = this.map.project(middleOf(site.bounds));
      const near = groups.find((group) => Math.hypot(group.at.x - at.x, group.at.y - at.y) < TOGETHER_PX);
      if (near) near.sites.push(site);
      else groups.push({ at, sites: [site] });
    }
    return groups;
  }

  draw() {
    const view = this.map.getBounds();
    this.insets.here(this.sites, [view.getWest(), view.getSouth(), view.getEast(), view.getNorth()]);
    this.marks.forEach((mark) => mark.remove());
    this.marks = this.sites.length < 2 ? [] : this.#groups().map(({ sites }) => this.#mark(sites));
  }

  #mark(sites) {
    const bounds = sites.map((site) => site.bounds).reduce(joined);
    const count = sites.reduce((sum, site) => sum + site.tracks.length, 0);
    const button = element("button", "site", String(count));
    button.type = "button";
    const name = sites.length === 1 ? `Site ${this.sites.indexOf(sites[0]) + 1}` : `${sites.length} sites`;
    button.ariaLabel = `${name}, ${many(count, "drive")}: go there`;
    button.title = button.ariaLabel;
    button.addEventListener("click", (event) => (event.stopPropagation(), this.#jump(bounds)));
    return new maplibregl.Marker({ element: button }).setLngLat(middleOf(bounds)).addTo(this.map);
  }
}
