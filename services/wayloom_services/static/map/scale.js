// Metres and pixels of Web Mercator, as MapLibre counts its zooms; and the addresses of one place on the map and in 3D.

const EQUATOR_M_PER_PX = 78_271.517; // at zoom 0, whose world is 512 pixels wide

const along = (lat) => EQUATOR_M_PER_PX * Math.cos((lat * Math.PI) / 180);
export const metresPerPixel = (lat, zoom) => along(lat) / 2 ** zoom;
export const zoomOf = (lat, mPerPx) => Math.log2(along(lat) / mPerPx);

// /3d at a place. distance: metres from it, or null as usual; drive: an id; version: one that is shown whatever is the newest.
export function addressIn3d([lon, lat], { distance = null, drive = null, version = null }) {
  const more = [distance && `distance=${distance.toFixed(0)}`, drive && `drive=${drive}`, version && `v=${version.version}`];
  return `/3d#${[`at=${lon.toFixed(7)},${lat.toFixed(7)}`, ...more].filter(Boolean).join("&")}`;
}
