// Tools beside the map: mounted once the map is there, in whatever form it came.

import { addressIn3d, metresPerPixel } from "/static/map/scale.js";

// city: the map's interface; about: { info, ask, at }.
export async function mountTools(city, { info, ask, at }) {
  if (!city.map) return; // the plain map, which has none
  const [{ Address }, { Changes }, { Legend }, { Lists }, { Sites }, { Told }, { Versions }] = await Promise.all(
    ["address", "changes", "legend", "lists", "sites_on_map", "told", "versions"].map((name) => import(`/static/map/${name}.js`)),
  );
  let address = null;
  const changed = (step) => address?.keep(step);
  const lists = new Lists(city.map.getContainer(), at("tools"));
  const told = new Told(city, () => changed(true));
  const legend = new Legend(at("legend"), city, info, changed);
  const versions = new Versions(city, info.map_id, ask, changed);
  new Sites(city, lists);
  const changes = new Changes(city, lists, told, ask);
  const listExcluded = () => (at("show-excluded").parentElement.hidden = !city.excluded.areas.features.length);
  city.excluded.changed = listExcluded;
  listExcluded();
  follow3d(city, at("to-3d"));
  city.hear("version", () => (at("version").textContent = `${info.map_id} · version ${city.shown.version}${city.pinned ? `, newest is ${city.newest.version}` : ""}`));
  address = new Address({ city, at, legend, versions, told });
  city.held = address.isPlaced;
  globalThis.wayloomTools = { address, told, legend, versions };
  city.map.once("idle", () => city.refit()); // now the panels are as large as they get
  city.map.triggerRepaint();
  city.map.on("moveend", () => changed(false));
  city.hear("visible", () => changed(true));
  city.hear("chosen", () => changed(true));
  addEventListener("popstate", () => address.restore());
  let restored = false;
  city.hear("version", () => {
    if (restored) return;
    restored = true;
    address.restore(true);
  });
  if (!city.newest) return void (address.quiet = false);
  // The map was quicker than its tools.
  restored = true;
  await Promise.all([versions.refresh(), changes.refresh()]);
  await address.restore(true);
}

// Keeps a link to 3D at the same place.
function follow3d(city, link) {
  const follow = () => {
    const { lng, lat } = city.map.getCenter();
    const metres = metresPerPixel(lat, city.map.getZoom()) * city.map.getContainer().clientHeight;
    link.href = addressIn3d([lng, lat], { distance: Math.max(metres, 15), drive: city.chosen, version: city.pinned });
  };
  city.map.on("moveend", follow);
  city.hear("chosen", follow);
  city.hear("version", follow);
  follow();
}
