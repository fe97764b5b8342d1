// One rig: what its drives say of its calibration over time, the stretches in which they agree, and the versions of its file.

import { chart } from "/static/drive/chart.js";
import { element, link, table } from "/static/ui/dom.js";
import { many, moment } from "/static/ui/words.js";

const DAY_S = 86400;

function ratioPlot(drives, name) {
  const known = drives.filter((one) => one.gnss_ratio !== null);
  if (!known.length) return element("p", "quiet", "No drive says by its GNSS how long its metres are.");
  const first = Math.min(...known.map((one) => one.recorded_at));
  const days = known.map((one) => (one.recorded_at - first) / DAY_S);
  const percent = known.map((one) => 100 * (one.gnss_ratio - 1));
  const sigma = known.map((one) => 100 * one.gnss_ratio_sigma);
  const { figure } = chart({
    title: `Scale of rig ${name} by GNSS over time`, text: `${known.length} drives, from ${Math.min(...percent).toFixed(2)} to ${Math.max(...percent).toFixed(2)} %.`,
    x: { label: `days since ${moment(first)}`, values: days }, y: { label: "% of a metre" },
    series: [
      { name: "metres of road per metre of odometry, less one", values: percent, kind: "dots", style: "start" },
      { name: "± σ", x: [...days, ...days], values: [...percent.map((one, k) => one - sigma[k]), ...percent.map((one, k) => one + sigma[k])], kind: "crosses", style: "two" },
    ],
  });
  return figure;
}

export function rigSection(rig) {
  const name = rig.rig_id ?? rig.vehicle_id ?? rig.id.slice(0, 12);
  const section = element("section");
  section.ariaLabel = `Rig ${name}`;
  const about = [rig.vehicle_id && `vehicle ${rig.vehicle_id}`, many(rig.drives.length, "drive"), `known since ${moment(rig.created_at)}`].filter(Boolean).join(" · ");
  section.append(element("h2", "", `Rig ${name}`), element("p", "quiet", about), ratioPlot(rig.drives, name));
  if (rig.epochs.length) {
    const rows = rig.epochs.map((one) => [moment(one.from_time), String(one.drives), one.chi_square === null ? "" : one.chi_square.toFixed(1), one.stray ? "one drive that agrees with nothing" : ""]);
    section.append(element("h3", "", "Stretches in which its drives agree"), table(rows, ["From", "Drives", "χ² against the one before", "Note"]));
  }
  if (rig.versions.length) {
    const rows = rig.versions.map((one) => [String(one.version), moment(one.created_at), one.reason, String(one.drives.length), link("RIG.toml", "", `/v1/rigs/${rig.id}/versions/${one.version}/RIG.toml`)]);
    section.append(element("h3", "", "Versions of its file"), table(rows, ["Version", "Made", "Why", "Drives", "File"]));
  } else section.append(element("p", "quiet", "Its drives have not yet said enough for a file of its own."));
  return section;
}
