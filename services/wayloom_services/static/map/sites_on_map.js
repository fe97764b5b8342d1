// Sites that are far apart: from afar, marks with how many drives there are; and a list to jump to each.

import * as maplibregl from "/static/vendor/maplibre-gl/maplibre-gl.mjs";
import { element } from "/static/ui/dom.js";
import { areaOf, joined, middleOf, sitesOf } from "/static/map/sites.js";
import { placesOf } from "/static/map/tracks.js";

const SPECK_PX = 70;
const TOGETHER_PX = 56;

export class Sites {
  constructor(city, list) {
    Object.assign(this, { city, map: city.map, list, sites: [], marks: [] });
    city.coverage.known = (features) => this.#know(sitesOf(features));
    this.map.on("moveend", () => this.draw());
    if (city.coverage.streets.features.length) this.#know(sitesOf(city.coverage.streets.features));
  }

  #know(sites) {
    this.sites = sites;
    this.list.fill("sites", "Sites", sites.length < 2 ? [] : sites.map((site, number) => ({
      title: `Site ${number + 1}`, words: `${this.#words(site)} · ${(areaOf(site.bounds) / 1e6).toFixed(2)} km²`, work: () => this.#jump(site.bounds),
    })));
    this.draw();
  }

  #jump([west, south, east, north]) {
    this.city.fitTo([[west, south], [east, north]]);
  }

  #drives({ bounds: [west, south, east, north] }) {
    return this.city.tracks.features.filter((one) => placesOf(one).some(([lon, lat]) => lon >= west && lon <= east && lat >= south && lat <= north)).length;
  }

  #words(site) {
    const count = this.#drives(site);
    return `${count} drive${count === 1 ? "" : "s"}`;
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
    this.marks.forEach((mark) => mark.remove());
    this.marks = this.sites.length < 2 ? [] : this.#groups().map(({ sites }) => this.#mark(sites));
  }

  #mark(sites) {
    const bounds = sites.map((site) => site.bounds).reduce(joined);
    const count = sites.reduce((sum, site) => sum + this.#drives(site), 0);
    const button = element("button", "site", String(count));
    button.type = "button";
    const name = sites.length === 1 ? `Site ${this.sites.indexOf(sites[0]) + 1}` : `${sites.length} sites`;
    button.ariaLabel = `${name}, ${count} drive${count === 1 ? "" : "s"}: go there`;
    button.title = button.ariaLabel;
    button.addEventListener("click", (event) => (event.stopPropagation(), this.#jump(bounds)));
    return new maplibregl.Marker({ element: button }).setLngLat(middleOf(bounds)).addTo(this.map);
  }
}
