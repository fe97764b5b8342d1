// The page of one drive: its grade with reasons, what was found of its GNSS, drift and loops, and its release by an operator.

import { ask, headers } from "/static/api.js";
import { element, gradeBadge } from "/static/drives.js";
import { showCaller, whoever } from "/static/session.js";

const at = (id) => document.getElementById(id);
const id = location.pathname.split("/").pop();
const VERDICTS = { merge: "merged into the map", hold: "held: it waits for drives that place it, or an operator", quarantine: "quarantined: not merged" };
const TITLES = {
  residuals: "GNSS residuals over time",
  drift: "Drift before and after",
  sigma: "Uncertainty along the road",
  track: "The track",
};

const caller = await whoever();
const mayOperate = caller.rights.includes("operate");
showCaller(caller, document.querySelector("header"));

const metres = (values) => `${values.map((value) => value.toFixed(2)).join(", ")} m`;

// Rows of the table: what is known, in the order of interest.
function numbers({ fixes, bursts, receiver, scale, drift, loops }, facts) {
  const counted = facts.georeference?.fixes;
  const rows = [];
  if (fixes) rows.push(["Fixes used, not used", `${counted.used}, ${counted.rejected}`]);
  for (const burst of bursts) rows.push(["GNSS burst", `${burst.from_s.toFixed(1)} to ${burst.to_s.toFixed(1)} s, off by ${metres(burst.offset_enu_m)} (east, north, up)`]);
  if (receiver) {
    rows.push(["Time offset", `${(1e3 * receiver.time_offset_s).toFixed(1)} ± ${(1e3 * receiver.sigma_time_offset_s).toFixed(1)} ms`]);
    rows.push(["Lever arm, correction", `${metres(receiver.lever_correction_m)} ± ${metres(receiver.sigma_lever_m)} (right, down, forward)`]);
  }
  if (scale) rows.push(["Scale of the odometry", `${scale.mean.toFixed(4)} ± ${scale.sigma.toFixed(4)}`]);
  if (drift) {
    const { percent, deg_per_100m: turn } = drift;
    rows.push(["Drift of the odometry", `${percent.median.toFixed(2)} % (worst ${percent.worst.toFixed(2)}), ${turn.median.toFixed(2)}° (worst ${turn.worst.toFixed(2)}°) per 100 m`]);
  }
  rows.push(["Loop closures", loops ? String(loops.count) : "none"]);
  return rows;
}

function showVerdict(drive) {
  document.title = `${drive.name} · wayloom`;
  at("name").textContent = drive.name;
  at("grade").replaceChildren(gradeBadge(drive.quality));
  at("state").textContent = drive.state;
  const { grade, gate, reasons, release, by_map: byMap } = drive.quality;
  const verdict = release ? "released" : byMap?.admitted ? `in the map with grade ${byMap.grade} by the drives that it meets` : VERDICTS[gate];
  at("verdict").textContent = `${grade ? `Grade ${grade} by its own GNSS` : "No GNSS of its own"}, ${verdict}`;
  at("by-map").hidden = !byMap;
  if (byMap) at("by-map").textContent = `The map says: ${byMap.reason}.`;
  at("reasons").replaceChildren(...reasons.map((reason) => element("li", "", reason)));
  at("release").hidden = !release;
  at("revoke").hidden = !release || !mayOperate;
  if (release) at("release").textContent = `Released by ${release.by} on ${new Date(1000 * release.at).toLocaleString()}: ${release.why}`;
  at("ask-release").hidden = !mayOperate || release !== null || gate === "merge" || drive.placed === false;
}

const RUNS = { running: "Being processed anew", publishing: "Processed anew, joining the map", failed: "Processing anew failed" };

// What is said of a new run; the rest of the page is of the result before.
function showRun({ state, stage, reprocess, images }) {
  const isOver = ["done", "held", "quarantined", "failed"].includes(state);
  at("reprocess").hidden = !mayOperate || !isOver || ["running", "publishing"].includes(reprocess?.state) || images.state !== "kept";
  at("anew").hidden = !reprocess;
  if (!reprocess) return;
  const more = reprocess.error ?? (reprocess.state === "running" && stage ? stage : "");
  at("anew").textContent = `${RUNS[reprocess.state]}${more ? `: ${more}` : ""}. This page shows the result before.`;
}

async function picture(name) {
  const answer = await fetch(`/v1/drives/${id}/quality/${name}.svg`, { headers: headers() });
  const image = element("img", "plot");
  image.alt = TITLES[name];
  image.src = URL.createObjectURL(await answer.blob());
  const section = element("section");
  section.append(element("h2", "", TITLES[name]), image);
  return section;
}

async function change(options) {
  try {
    showVerdict(await ask(`/v1/drives/${id}/release`, options));
    at("problem").hidden = true;
  } catch (error) {
    tell(error);
  }
}

function tell(error) {
  at("problem").hidden = false;
  at("problem").textContent = error.message;
}

at("ask-release").addEventListener("submit", (event) => {
  event.preventDefault();
  change({ method: "POST", body: JSON.stringify({ by: at("by").value, why: at("why").value }) });
});
at("revoke").addEventListener("click", () => change({ method: "DELETE" }));
at("reprocess").addEventListener("click", () => ask(`/v1/drives/${id}/reprocess`, { method: "POST" }).then(showRun, tell));

try {
  const drive = await ask(`/v1/drives/${id}`);
  showRun(drive);
  if (!drive.quality) throw new Error(`${drive.name} is not judged yet.`);
  showVerdict(drive);
  const quality = await ask(`/v1/drives/${id}/quality`);
  at("numbers").replaceChildren(
    ...numbers(quality, drive.facts).map((row) => {
      const line = element("tr");
      line.append(...row.map((text) => element("td", "", text)));
      return line;
    }),
  );
  const order = Object.keys(TITLES).filter((name) => quality.pictures.includes(name));
  at("pictures").replaceChildren(...(await Promise.all(order.map(picture))));
} catch (error) {
  tell(error);
}
