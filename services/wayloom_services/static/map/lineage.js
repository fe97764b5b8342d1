// What a place of the map was made from: its drives with a link to each, and how they were processed.

import { ask } from "/static/api.js";
import { element } from "/static/ui/dom.js";
import { many } from "/static/ui/words.js";

export const day = (seconds) => new Date(1000 * seconds).toISOString().slice(0, 10);

// asked: { lon, lat, radius_m } or { tile }.
export function lineageOf(mapId, version, asked) {
  return ask(`/v1/maps/${mapId}/versions/${version}/lineage?${new URLSearchParams(asked)}`);
}

// Rows of [what, a text or a node].
export function factTable(rows) {
  const table = element("table", "facts");
  for (const [name, value] of rows) {
    const row = table.insertRow();
    const cell = element("td");
    cell.append(value);
    row.append(Object.assign(element("th", "", name), { scope: "row" }), cell);
  }
  return table;
}

export function driveList(drives) {
  const list = element("ul", "lineage");
  for (const { id, name, vehicle_id: vehicle, submaps, run } of drives) {
    const item = element("li");
    const link = element("a", "", name ?? id.slice(0, 12));
    link.href = `/drives/${id}`;
    const parts = [vehicle, submaps.length && many(submaps.length, "submap"), run?.network?.name && `labelled by ${run.network.name}`];
    item.append(link, element("span", "quiet", ` ${parts.filter(Boolean).join(" · ")}`));
    list.append(item);
  }
  return list;
}
