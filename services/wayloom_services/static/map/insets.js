// Insets: a small plan of each site that lies apart, with where it is and how many drives there are; a click leads there.

import { element, svg } from "/static/ui/dom.js";
import { areaOf, middleOf, sizeOf } from "/static/map/sites.js";
import { placesOf } from "/static/map/tracks.js";
import { many } from "/static/ui/words.js";

const [WIDTH, HEIGHT, EDGE] = [96, 56, 4];
const MOST = 12;
const MOST_PLACES = 60;

const metres = ([wide, high]) => (Math.max(wide, high) < 1000 ? `${wide.toFixed(0)} × ${high.toFixed(0)} m` : `${(wide / 1000).toFixed(1)} × ${(high / 1000).toFixed(1)} km`);
const thinned = (places) => places.filter((_, row) => row % Math.ceil(places.length / MOST_PLACES) === 0 || row === places.length - 1);

export class Insets {
  // into: the map's container. go(bounds): shows a site.
  constructor(into, go) {
    Object.assign(this, { go, shown: "", cards: [] });
    this.root = Object.assign(element("section"), { id: "insets", ariaLabel: "Sites", hidden: true });
    into.append(this.root);
  }

  // sites: [{ bounds, areas: polygons, tracks: features of the drives that were there }], the largest first.
  show(sites) {
    const wanted = sites.length < 2 ? [] : sites.slice(0, MOST);
    const key = JSON.stringify(wanted.map(({ bounds, areas, tracks }) => [bounds, areas.length, tracks.map(({ properties: { id } }) => id)]));
    if (key === this.shown) return;
    this.shown = key;
    const had = this.cards.indexOf(document.activeElement);
    this.cards = wanted.map((site, number) => this.#card(site, number));
    this.root.hidden = !wanted.length;
    this.root.replaceChildren(...this.cards);
    this.cards[had]?.focus();
  }

  // Marks the sites whose middle is in view. view: [west, south, east, north]
  here(sites, [west, south, east, north]) {
    this.cards.forEach((card, number) => {
      const [lon, lat] = middleOf(sites[number].bounds);
      const isHere = areaOf(sites[number].bounds) > areaOf([west, south, east, north]) / 50 && lon >= west && lon <= east && lat >= south && lat <= north;
      card.ariaCurrent = isHere ? "location" : null;
    });
  }

  #card({ bounds, areas, tracks }, number) {
    const [lon, lat] = middleOf(bounds);
    const card = element("button", "inset");
    card.type = "button";
    const size = metres(sizeOf(bounds));
    const facts = [`${lat.toFixed(4)}, ${lon.toFixed(4)}`, many(tracks.length, "drive"), size];
    card.ariaLabel = `Site ${number + 1}: ${facts.join(", ")}: go there`;
    card.append(planOf(bounds, areas, tracks), element("b", "", `Site ${number + 1}`), ...facts.map((text) => element("span", "quiet", text)));
    card.addEventListener("click", () => this.go(bounds));
    return card;
  }
}

// The site from above, north up, both axes to one scale.
function planOf(bounds, areas, tracks) {
  const [west, , , north] = bounds;
  const [wide, high] = sizeOf(bounds);
  const scale = Math.min((WIDTH - 2 * EDGE) / Math.max(wide, 1), (HEIGHT - 2 * EDGE) / Math.max(high, 1));
  const perDegree = [wide / (bounds[2] - west || 1), high / (north - bounds[1] || 1)];
  const [left, top] = [(WIDTH - scale * wide) / 2, (HEIGHT - scale * high) / 2];
  const pixel = ([lon, lat]) => `${(left + scale * perDegree[0] * (lon - west)).toFixed(1)},${(top + scale * perDegree[1] * (north - lat)).toFixed(1)}`;
  const plan = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" });
  const ring = (places) => `M${places.map(pixel).join("L")}Z`;
  plan.append(svg("path", { class: "area", "fill-rule": "evenodd", d: areas.map(({ coordinates }) => coordinates.map(ring).join("")).join("") }));
  for (const feature of tracks) plan.append(svg("polyline", { points: thinned(placesOf(feature)).map(pixel).join(" ") }));
  return plan;
}
