// Sites: parts of the map that lie apart, by the areas that its drives cover.

const GAP_M = 400;
const M_PER_DEGREE = 111_320;
// Beside what drives cover, for the fronts along it: the margin of a first view.
export const BESIDE_M = 25;

export const boxOf = (polygon) => {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [lon, lat] of polygon.coordinates[0]) {
    box[0] = Math.min(box[0], lon);
    box[1] = Math.min(box[1], lat);
    box[2] = Math.max(box[2], lon);
    box[3] = Math.max(box[3], lat);
  }
  return box;
};

export const joined = (a, b) => [Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.max(a[2], b[2]), Math.max(a[3], b[3])];
export const middleOf = ([west, south, east, north]) => [(west + east) / 2, (south + north) / 2];

// Metres from west to east and from south to north.
export const sizeOf = ([west, south, east, north]) => [
  (east - west) * M_PER_DEGREE * Math.cos((((south + north) / 2) * Math.PI) / 180), (north - south) * M_PER_DEGREE,
];

// The box with so many metres more on each side.
export function wider([west, south, east, north], metres) {
  const up = metres / M_PER_DEGREE;
  const aside = up / Math.max(Math.cos((((south + north) / 2) * Math.PI) / 180), 0.05);
  return [west - aside, south - up, east + aside, north + up];
}

export function areaOf(bounds) {
  const [wide, high] = sizeOf(bounds);
  return wide * high;
}

function near(a, b) {
  const [dLat, dLon] = [GAP_M / M_PER_DEGREE, GAP_M / (M_PER_DEGREE * Math.max(Math.cos((a[1] * Math.PI) / 180), 0.05))];
  return a[0] - dLon <= b[2] && b[0] - dLon <= a[2] && a[1] - dLat <= b[3] && b[1] - dLat <= a[3];
}

// [{ bounds: [west, south, east, north], areas: polygons }], the largest first; areas less than 400 m apart are of one site.
export function sitesOf(features) {
  let sites = features.map(({ geometry }) => ({ bounds: boxOf(geometry), areas: [geometry] }));
  for (let before = Infinity; sites.length < before; ) {
    before = sites.length;
    const next = [];
    for (const site of sites) {
      const row = next.findIndex(({ bounds }) => near(bounds, site.bounds));
      if (row < 0) next.push(site);
      else next[row] = { bounds: joined(next[row].bounds, site.bounds), areas: [...next[row].areas, ...site.areas] };
    }
    sites = next;
  }
  return sites.sort((a, b) => areaOf(b.bounds) - areaOf(a.bounds));
}
