// What lies where somebody clicked, or pressed Enter over the middle of the map: a thing, a drive, voxels or a tile, with the drives it was made from.

import { element } from "/static/ui/dom.js";
import { day, driveList, factTable, lineageOf } from "/static/map/lineage.js";
import { addressIn3d, metresPerPixel } from "/static/map/scale.js";
import { many } from "/static/ui/words.js";

const EMPTY = { type: "FeatureCollection", features: [] };
const NEAR_PX = 5;
const VOXELS_FROM_ZOOM = 17;
const COARSEST_TILE = 14;
const LISTED = 8;
const WORDS = { drive_count: "drives that saw it" };

const value = (name, what) => {
  const text = typeof what === "number" ? String(Number(what.toFixed(3))) : String(what);
  return name.endsWith("_m") ? `${text} m` : name.endsWith("_m2") ? `${text} m²` : name.endsWith("_deg") ? `${text}°` : text;
};
const IDS = /^\["[0-9a-f]{64}"(, ?"[0-9a-f]{64}")*\]$/; // as MapLibre hands on a list
const SAID_ABOVE = new Set(["kind", "class"]);

export class Told {
  // changed(): the place or thing that is told of has changed.
  constructor(city, changed) {
    Object.assign(this, { city, map: city.map, changed, asked: 0, place: null });
    this.panel = element("section");
    Object.assign(this.panel, { id: "told", hidden: true, tabIndex: -1, ariaLabel: "What is here" });
    this.map.getContainer().append(this.panel, Object.assign(element("span", ""), { id: "crosshair", ariaHidden: "true" }));
    this.map.on("click", (event) => this.tellOf([event.lngLat.lng, event.lngLat.lat], event.point));
    this.map.on("mousemove", (event) => (this.map.getCanvas().style.cursor = this.#things(event.point).length ? "pointer" : ""));
    this.map.getCanvas().addEventListener("keydown", (event) => event.key === "Enter" && this.#middle());
    this.panel.addEventListener("keydown", (event) => event.key === "Escape" && this.close());
    this.map.getCanvas().addEventListener("keydown", (event) => event.key === "Escape" && this.close());
    city.hear("version", () => this.#tellAgain());
    city.ready.then(() => this.#addMark());
  }

  #addMark() {
    this.map.addSource("told", { type: "geojson", data: EMPTY });
    this.map.addLayer({ id: "told-tile", type: "line", source: "told", filter: ["==", ["geometry-type"], "Polygon"], paint: { "line-color": "#e0662a", "line-width": 2 } });
    this.map.addLayer({
      id: "told-point", type: "circle", source: "told", filter: ["==", ["geometry-type"], "Point"],
      paint: { "circle-radius": 9, "circle-opacity": 0, "circle-stroke-color": "#e0662a", "circle-stroke-width": 2.5 },
    });
  }

  #middle() {
    const { lng, lat } = this.map.getCenter();
    this.tellOf([lng, lat], this.map.project([lng, lat]));
    this.panel.focus();
  }

  // Features under a pixel, those that matter most first.
  #things({ x, y }) {
    const layers = ["changes", "objects", "tracks", "markings", "kerbs", "areas"].filter((id) => this.map.getLayer(id));
    const found = this.map.queryRenderedFeatures([[x - NEAR_PX, y - NEAR_PX], [x + NEAR_PX, y + NEAR_PX]], { layers });
    return found.sort((a, b) => layers.indexOf(a.layer.id) - layers.indexOf(b.layer.id));
  }

  close() {
    if (this.panel.hidden) return;
    const hadFocus = this.panel.contains(document.activeElement);
    this.panel.hidden = true;
    this.panel.className = "";
    this.place = null;
    this.asked++;
    this.map.getSource("told")?.setData(EMPTY);
    if (hadFocus) this.map.getCanvas().focus();
    this.changed();
  }

  // What is here in the version that is shown by now.
  async #tellAgain() {
    if (this.panel.hidden || this.told === this.city.shown) return;
    await new Promise((resolve) => this.map.once("idle", resolve));
    if (!this.panel.hidden && this.told !== this.city.shown) await this.tellOf(this.place, this.map.project(this.place));
  }

  // place: longitude, latitude. point: its pixel, or null where only the place counts.
  async tellOf(place, point = null) {
    const mine = ++this.asked;
    const version = (this.told = this.city.shown);
    const [thing] = point ? this.#things(point) : [];
    this.place = place;
    this.panel.hidden = false;
    this.panel.className = "about";
    this.#head(thing);
    if (thing) this.panel.append(this.#about(thing));
    this.#mark(place);
    this.changed();
    if (!version) return;
    const rest = element("div", "rest quiet", "asking what the map here was made from");
    this.panel.append(rest);
    try {
      const parts = await this.#lineage(version, place);
      if (mine === this.asked) rest.replaceChildren(...parts);
      rest.classList.remove("quiet");
    } catch (error) {
      if (mine === this.asked) rest.textContent = error.message;
    }
  }

  #head(thing) {
    const titles = { changes: () => `${thing.properties.class} ${thing.properties.kind === "gone" ? "has gone" : "is new"}`, objects: () => thing.properties.kind.replaceAll("_", " "), tracks: () => thing.properties.name, areas: () => `${thing.properties.kind} area` };
    const title = element("h2", "", thing ? (titles[thing.layer.id]?.() ?? thing.properties.kind ?? thing.layer.id) : "Place");
    const close = Object.assign(element("button", "", "Close"), { type: "button" });
    close.addEventListener("click", () => this.close());
    title.append(close);
    const [lon, lat] = this.place;
    const where = element("p", "quiet", `${lat.toFixed(6)}, ${lon.toFixed(6)} · `);
    const link = element("a", "", "in 3D");
    const height = this.map.getContainer().clientHeight;
    const metres = metresPerPixel(lat, this.map.getZoom()) * height;
    link.href = addressIn3d([lon, lat], { distance: Math.min(metres, 200), drive: this.city.chosen, version: this.city.pinned });
    where.append(link);
    this.panel.replaceChildren(title, where);
  }

  #rows(properties) {
    const nameOf = (id) => this.city.tracks.drives.get(id)?.properties.name ?? id.slice(0, 12);
    const words = (name, what) => (IDS.test(what) ? JSON.parse(what).map(nameOf).join(", ") : value(name, what));
    const rows = Object.entries(properties).filter(([name]) => !SAID_ABOVE.has(name));
    return rows.map(([name, what]) => [WORDS[name] ?? name.replace(/_(m|m2|deg)$/, "").replaceAll("_", " "), words(name, what)]);
  }

  #about({ layer, properties }) {
    if (layer.id !== "tracks") return factTable(this.#rows(properties));
    const link = element("a", "", "the drive's page");
    link.href = `/drives/${properties.id}`;
    return factTable([["vehicle", properties.vehicle || "none"], ["grade", properties.grade || "none"], ["driven", day(properties.when)], ["report", link]]);
  }

  async #lineage(version, [lon, lat]) {
    const zoom = Math.floor(this.map.getZoom());
    if (zoom >= VOXELS_FROM_ZOOM) {
      const found = await lineageOf(version.map_id, version.version, { lon: lon.toFixed(8), lat: lat.toFixed(8), radius_m: 1 });
      return this.#made(found, found.voxels);
    }
    if (zoom < COARSEST_TILE) return [element("p", "quiet", "Come nearer to see what it was made from.")];
    const [x, y] = tileAt(zoom, [lon, lat]);
    this.#mark([lon, lat], boxOfTile(zoom, x, y));
    const found = await lineageOf(version.map_id, version.version, { tile: `${zoom}/${x}/${y}` });
    return [factTable([["tile", `${zoom}/${x}/${y}`], ["regions", String(found.regions.length)]]), ...this.#made(found, null)];
  }

  #made({ drives, version }, voxels) {
    const parts = [];
    if (voxels?.length) {
      const table = element("table", "voxels");
      table.createCaption().textContent = `${many(voxels.length, "voxel")} within 1 m`;
      const head = table.createTHead().insertRow();
      for (const name of ["class", "height", "drives", "last seen"]) head.append(Object.assign(element("th", "", name), { scope: "col" }));
      for (const one of voxels.slice(0, LISTED)) {
        const row = table.insertRow();
        const label = one.layer === "static" ? one.label : `${one.label}, ${one.layer}`;
        for (const text of [label, `${one.height_m.toFixed(2)} m`, one.drives.length, day(one.last_seen)]) row.insertCell().textContent = text;
      }
      parts.push(table);
    }
    const title = drives.length ? `The map here is from ${many(drives.length, "drive")}, version ${version}` : `Nothing is mapped here in version ${version}`;
    parts.push(element("h3", "", title), driveList(drives));
    return parts;
  }

  #mark([lon, lat], box = null) {
    const geometry = box ? { type: "Polygon", coordinates: [box] } : { type: "Point", coordinates: [lon, lat] };
    this.map.getSource("told")?.setData({ type: "Feature", geometry, properties: {} });
  }
}

// Latitude in the square of Web Mercator, -1 to 1.
const mercator = (lat) => Math.asinh(Math.tan((lat * Math.PI) / 180)) / Math.PI;

function tileAt(zoom, [lon, lat]) {
  return [Math.floor(((lon + 180) / 360) * 2 ** zoom), Math.floor(((1 - mercator(lat)) / 2) * 2 ** zoom)];
}

function boxOfTile(zoom, x, y) {
  const lon = (column) => (column / 2 ** zoom) * 360 - 180;
  const lat = (row) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * row) / 2 ** zoom))) * 180) / Math.PI;
  const [west, east, north, south] = [lon(x), lon(x + 1), lat(y), lat(y + 1)];
  return [[west, south], [east, south], [east, north], [west, north], [west, south]];
}
