// Excluded areas: those that there are, one more by GeoJSON, one less.

import { ask } from "/static/api.js";
import { dialog } from "/static/ui/dialogs.js";
import { at, button, element, table } from "/static/ui/dom.js";
import { announce, follow, frame, telling } from "/static/ui/frame.js";
import { moment } from "/static/ui/words.js";

const caller = await frame();
const mayOperate = caller.rights.includes("operate");
at("add").hidden = !mayOperate;

const places = ({ coordinates }) => coordinates.flat(Infinity).length / 2;
const centre = ({ coordinates }) => {
  const flat = coordinates.flat(Infinity);
  const mean = (from) => flat.filter((_, k) => k % 2 === from).reduce((sum, one) => sum + one, 0) / (flat.length / 2);
  return `${mean(1).toFixed(5)}°, ${mean(0).toFixed(5)}°`;
};

async function refresh() {
  const { features } = await ask("/v1/excluded-areas");
  if (!features.length) return at("areas").replaceChildren(element("p", "quiet", "No area is excluded."));
  const rows = features.map(({ id, geometry, properties: { name, source, created_at: at, since_version: since } }) => [
    name, centre(geometry), String(places(geometry)), source === "settings" ? "the settings' file" : "here", moment(at), since === null ? "is being made" : `version ${since}`,
    mayOperate && source === "service" ? button("Remove…", "danger", () => remove(id, name)) : "",
  ]);
  at("areas").replaceChildren(table(rows, ["Name", "Centre", "Corners", "By", "Since", "Out of the map from", "Actions"]));
}

const renew = () => telling("list", refresh);

async function remove(id, name) {
  const done = await dialog({
    title: `Remove ${name}`, action: "Remove", danger: true, text: "The map may have the area again, of drives that come from now on or are processed anew.",
    work: () => ask(`/v1/excluded-areas/${id}`, { method: "DELETE" }),
  });
  if (!done) return;
  announce(`${name} is removed`);
  await renew();
}

// The text as a feature of this name, where it has none of its own.
function named(text, name) {
  const found = JSON.parse(text);
  if (!name || found.type === "FeatureCollection") return found;
  const feature = found.type === "Feature" ? found : { type: "Feature", geometry: found, properties: {} };
  return { ...feature, properties: { name, ...feature.properties } };
}

async function add(form) {
  const { features } = await ask("/v1/excluded-areas", { method: "POST", body: JSON.stringify(named(at("geojson").value, at("area-name").value.trim())) });
  announce(`${features.length} added`);
  form.reset();
  await refresh();
}

at("file").addEventListener("change", ({ target: { files } }) =>
  telling("add", async () => {
    if (files[0]) at("geojson").value = await files[0].text();
  }),
);
at("add-form").addEventListener("submit", (event) => {
  event.preventDefault();
  telling("add", () => add(event.target));
});

await renew();
follow((event) => event === "map" && renew(), renew);
