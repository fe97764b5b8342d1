// The dashboard: what the service knows of drives and map, kept current by its events.

import { ask, listen } from "/static/api.js";
import { fillCard } from "/static/drives.js";
import { MapHost } from "/static/map_host.js";
import { showCaller, whoever } from "/static/session.js";

const at = (id) => document.getElementById(id);
const cards = new Map();
const drives = new Map();
let chosen = null;
let shownVersion = 0;

const [info, caller] = await Promise.all([ask("/v1/info"), whoever()]);
const mayOperate = caller.rights.includes("operate");
showCaller(caller, document.querySelector("header"));

at("hint").textContent = `wayloom upload LOG --to ${location.origin}`;
at("legend").querySelector("ul").append(
  ...info.classes.filter((one) => one.in_map).map(({ name, colour }) => {
    const item = document.createElement("li");
    const square = document.createElement("i");
    square.style.background = colour;
    item.append(square, name);
    return item;
  }),
);
if (matchMedia("(max-width: 800px)").matches) at("legend").open = false;
at("fit").addEventListener("click", () => city.fit());
for (const name of info.overlays) {
  const label = document.createElement("label");
  const box = document.createElement("input");
  box.id = `show-${name}`;
  box.type = "checkbox";
  label.append(box, ` ${name[0].toUpperCase()}${name.slice(1)}`);
  at("tools").append(label);
}
const city = new MapHost(at("map"), info, at);
const TOGGLES = ["ortho", "semantic", "areas", "markings", "objects", "tracks", "coverage", ...info.overlays];
for (const name of TOGGLES) {
  at(`show-${name}`).addEventListener("change", (event) => city.visible(name, event.target.checked));
}

function choose(id) {
  cards.get(chosen)?.classList.remove("chosen");
  cards.get(id)?.classList.add("chosen");
  city.choose(id, chosen);
  chosen = id;
}

function card(id) {
  if (!cards.has(id)) {
    const made = document.createElement("li");
    made.className = "drive";
    made.tabIndex = 0;
    made.addEventListener("click", () => choose(id));
    made.addEventListener("keydown", (event) => event.key === "Enter" && choose(id));
    cards.set(id, made);
    at("drives").prepend(made);
  }
  return cards.get(id);
}

function count() {
  const working = [...drives.values()].filter(({ state }) => ["queued", "running", "stitching"].includes(state)).length;
  at("count").textContent = drives.size ? `${drives.size}${working ? `, ${working} in work` : ""}` : "";
  at("empty").hidden = drives.size > 0;
}

async function showMap({ id, version }) {
  if (id !== info.map_id || version === 0 || version === shownVersion) return;
  shownVersion = version;
  const found = await ask(`/v1/maps/${id}/versions/${version}`);
  if (version !== shownVersion) return;
  at("version").textContent = `${id} · version ${version}`;
  const many = (number, word) => `${number.toLocaleString("en")} ${word}${number === 1 ? "" : "s"}`;
  at("facts").textContent = [many(found.drives.length, "drive"), many(found.submaps, "submap"), many(found.tiles, "tile")].join(" · ");
  for (const name of ["ortho", "areas", "markings", "objects"]) at(`show-${name}`).parentElement.hidden = !found.layers[name];
  await city.show(found);
  for (const name of TOGGLES) await city.visible(name, at(`show-${name}`).checked);
}

function hear(event, data) {
  if (event === "drive") {
    drives.set(data.id, data);
    fillCard(card(data.id), data, mayOperate ? () => ask(`/v1/drives/${data.id}/retry`, { method: "POST" }) : null);
    city.track(data);
  } else if (event === "removed") {
    drives.delete(data.id);
    cards.get(data.id)?.remove();
    cards.delete(data.id);
    city.forget(data.id);
  } else if (event === "map") {
    showMap(data).catch(() => (shownVersion = 0));
  }
  count();
}

function live(state) {
  at("live").textContent = state;
  at("live").className = `pill ${state === "live" ? "good" : state === "polling" ? "" : "bad"}`;
}

count();
listen(hear, live);
