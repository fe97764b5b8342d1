// What is known of a point: its class and votes by the tile, its drives by the map's lineage.

import { element } from "/static/ui/dom.js";
import { day, driveList, factTable, lineageOf } from "/static/map/lineage.js";

let asked = 0;

// into: the panel. point: of PointScene.pick, or null. back(): where the keyboard goes when it is closed.
export async function tellPoint(into, point, { info, version, frame, back }) {
  const mine = ++asked;
  into.hidden = !point;
  if (!point) return;
  const known = info.classes.find(({ id }) => id === point.label);
  const [lon, lat, height] = frame.geographic(point.place);
  const title = element("h2", "", known?.name ?? `class ${point.label}`);
  const close = element("button", "", "Close");
  close.type = "button";
  close.addEventListener("click", () => ((into.hidden = true), back()));
  title.append(close);
  const rows = [
    ["Drives", point.drives >= 255 ? "255 or more" : String(point.drives)], ["Votes for the class", `${Math.round(100 * point.confidence)} %`],
    ["Last seen", point.lastSeen ? day(86_400 * point.lastSeen) : "not known"],
    ["Place", `${lat.toFixed(6)}, ${lon.toFixed(6)}`], ["Height", `${height.toFixed(2)} m`],
  ];
  const drives = element("div", "quiet", "asking for its drives");
  into.replaceChildren(title, factTable(rows), drives);
  try {
    const found = await lineageOf(info.map_id, version, { lon: lon.toFixed(8), lat: lat.toFixed(8), radius_m: 0.3 });
    if (mine !== asked) return;
    const voxel = found.voxels.toSorted((a, b) => Math.abs(a.height_m - height) - Math.abs(b.height_m - height))[0];
    const voters = voxel ? found.drives.filter(({ id }) => voxel.drives.includes(id)) : [];
    drives.className = "";
    drives.replaceChildren(element("h3", "", voters.length ? "Seen by" : "Of the drives nearby"), driveList(voters.length ? voters : found.drives));
  } catch (error) {
    if (mine === asked) drives.textContent = error.message;
  }
}
