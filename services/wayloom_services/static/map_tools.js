// Tools beside the map: mounted once the map is there, in whatever form it came.

import { element } from "/static/ui/dom.js";

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
  const legend = new Legend(at("legend"), city, info.classes.filter((one) => one.in_map), changed);
  const versions = new Versions(city, info.map_id, ask, changed);
  new Sites(city, lists);
  const changes = new Changes(city, lists, told, ask);
  at("tools").append(linkTo3d(city));
  address = new Address({ city, at, legend, versions, told });
  city.held = address.isPlaced;
  globalThis.wayloomTools = { address, told, legend, versions };
  city.map.on("moveend", () => changed(false));
  city.hear("visible", () => changed(true));
  city.hear("chosen", () => changed(true));
  addEventListener("popstate", () => address.restore());
  let restored = false;
  city.hear("version", () => {
    if (restored) return;
    restored = true;
    address.restore();
  });
  if (!city.newest) return void (address.quiet = false);
  // The map was quicker than its tools.
  restored = true;
  await Promise.all([versions.refresh(), changes.refresh()]);
  await address.restore();
}

// To the same place in 3D.
function linkTo3d(city) {
  const link = element("a", "tool", "3D");
  link.id = "to-3d";
  const follow = () => {
    const { lng, lat } = city.map.getCenter();
    const metres = (78_271.517 * Math.cos((lat * Math.PI) / 180) * city.map.getContainer().clientHeight) / 2 ** city.map.getZoom();
    link.href = `/3d#at=${lng.toFixed(7)},${lat.toFixed(7)}&distance=${Math.max(metres, 15).toFixed(0)}${city.chosen ? `&drive=${city.chosen}` : ""}${city.pinned ? `&v=${city.pinned.version}` : ""}`;
  };
  city.map.on("moveend", follow);
  city.hear("chosen", follow);
  city.hear("version", follow);
  follow();
  return link;
}
