// The dashboard: the list of drives and what an operator does with them, kept current by events; the map beside it comes when it comes.

import { ask } from "/static/api.js";
import { DriveList } from "/static/list/list.js";
import { MapHost } from "/static/map_host.js";
import { at, element, say } from "/static/ui/dom.js";
import { follow, frame } from "/static/ui/frame.js";
import { onGround } from "/static/ui/tones.js";
import { many } from "/static/ui/words.js";

const [info, caller] = await Promise.all([ask("/v1/info"), frame()]);
let shownVersion = 0;

const list = new DriveList({ caller, models: info.models, choose });
const filled = list.load();

at("hint").textContent = `wayloom upload LOG --to ${location.origin}`;
at("legend").querySelector("ul").append(
  ...info.classes.filter((one) => one.in_map).map(({ name, colour }) => {
    const item = element("li");
    const square = element("i");
    square.style.background = onGround(colour);
    item.append(square, name);
    return item;
  }),
);
if (matchMedia("(max-width: 800px)").matches) at("legend").open = false;
for (const name of info.overlays) {
  const label = element("label");
  const box = element("input");
  box.id = `show-${name}`;
  box.type = "checkbox";
  label.append(box, ` ${name[0].toUpperCase()}${name.slice(1)}`);
  at("layers").append(label);
}

await filled; // what an operator came for is there before a megabyte of map is asked for
const city = new MapHost(at("map"), info, at, (id) => list.choose(id));
at("fit").addEventListener("click", () => city.fit());
const TOGGLES = ["ortho", "semantic", "areas", "markings", "objects", "tracks", "coverage", "excluded", ...info.overlays];
for (const name of TOGGLES) {
  at(`show-${name}`).addEventListener("change", (event) => city.visible(name, event.target.checked));
}

// Its card is marked at once; its way, where it has not come by an event, is asked for.
function choose(id) {
  list.choose(id);
  city.choose(id);
  city.track(list.drive(id));
}

async function showMap({ id, version }) {
  if (id !== info.map_id || version === 0 || version === shownVersion) return;
  shownVersion = version;
  const found = await ask(`/v1/maps/${id}/versions/${version}`);
  if (version !== shownVersion) return;
  at("version").textContent = `${id} · version ${version}`;
  at("no-map").hidden = true;
  at("facts").textContent = [many(found.drives.length, "drive"), many(found.submaps, "submap"), many(found.tiles, "tile")].join(" · ");
  for (const name of ["ortho", "areas", "markings", "objects"]) at(`show-${name}`).parentElement.hidden = !found.layers[name];
  await city.show(found);
  for (const name of TOGGLES) await city.visible(name, at(`show-${name}`).checked);
}

function hear(event, data) {
  if (event === "drive") {
    list.hear(data);
    city.track(data);
  } else if (event === "removed") {
    list.forget(data.id);
    city.forget(data.id);
  } else if (event === "map") {
    at("no-map").hidden = data.version > 0;
    showMap(data).catch(() => (shownVersion = 0));
  }
}

if (caller.rights.includes("send")) {
  import("/static/upload/panel.js").then(({ mountUpload }) => mountUpload()).catch((error) => say(at("problem"), `No upload: ${error.message}`));
}
follow(hear, () => list.load());
