// What has gone and what is new, on the map and in a list.

import { CHANGES } from "/static/map/style.js";

const EMPTY = { type: "FeatureCollection", features: [] };
const LISTED = 200;

export class Changes {
  // told: where a thing that is chosen in the list is told of.
  constructor(city, list, told, ask) {
    Object.assign(this, { city, map: city.map, list, told, ask, asked: 0 });
    city.ready.then(() => this.#addLayer());
    city.hear("version", () => this.refresh().catch(() => {}));
  }

  #addLayer() {
    this.map.addSource("changes", { type: "geojson", data: EMPTY });
    this.map.addLayer({
      id: "changes", type: "circle", source: "changes",
      paint: {
        "circle-color": ["match", ["get", "kind"], "gone", CHANGES.gone, CHANGES.new], "circle-stroke-color": "#ffffff", "circle-stroke-width": 1.5,
        "circle-radius": ["interpolate", ["linear"], ["zoom"], 12, 3, 20, 9],
      },
    });
  }

  // Of the newest version all that it lists; of an older one what it brought.
  async refresh() {
    const version = this.city.shown;
    const mine = ++this.asked;
    if (!version) return;
    const path = `/v1/maps/${version.map_id}`;
    const found = this.city.pinned ? (await this.ask(`${path}/versions/${version.version}/changes`)).things : await this.ask(`${path}/changes`);
    await this.city.ready;
    if (mine !== this.asked) return;
    this.map.getSource("changes")?.setData(found);
    const newestFirst = found.features.toSorted((a, b) => `${b.properties.noticed}`.localeCompare(`${a.properties.noticed}`));
    this.list.fill("changes", "Changes", newestFirst.slice(0, LISTED).map((feature) => this.#row(feature)));
  }

  #row({ geometry: { coordinates: [lon, lat] }, properties }) {
    return {
      title: `${properties.class ?? "thing"} ${properties.kind === "gone" ? "has gone" : "is new"}`, words: `noticed ${`${properties.noticed}`.slice(0, 10)}`,
      mark: properties.kind === "gone" ? "gone" : "new",
      work: async () => {
        this.map.jumpTo({ center: [lon, lat], zoom: Math.max(this.map.getZoom(), 19) });
        await this.map.once("idle");
        this.told.tellOf([lon, lat], this.map.project([lon, lat]));
      },
    };
  }
}
