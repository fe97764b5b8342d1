// The fleet: what waits and runs, room on the disk, the jobs of the map, vehicles with their drives, and each rig's calibration over time.

import { ask } from "/static/api.js";
import { rigSection } from "/static/fleet/rig.js";
import { at, element, link, table } from "/static/ui/dom.js";
import { follow, frame, telling } from "/static/ui/frame.js";
import { duration, many, moment, size, STATES } from "/static/ui/words.js";

const WAIT_MS = 1500;
const RENEW_MS = 10_000;
let asked = 0;
const JOBS = 50;
const [info] = await Promise.all([ask("/v1/info"), frame()]);

const progress = (share, name) => {
  const bar = element("progress");
  Object.assign(bar, { max: 1, value: share, ariaLabel: name });
  return bar;
};

function showQueues(queues) {
  const rows = queues.map(({ name, queued, running }) => [name, String(queued), String(running)]);
  at("queues").replaceChildren(table(rows, ["Queue", "Waiting", "Running"]));
}

const held = ({ nominal, measured, judged }) =>
  judged ? `${Math.round(100 * measured)} % of ${judged} came true, ${Math.round(100 * nominal)} % should` : "none judged yet";

function showStorage({ storage, version, retention, eta }) {
  const rows = [
    ["Disk", progress(storage.used / storage.total, "Share of the disk that is used")],
    ["Free", `${size(storage.free)} of ${size(storage.total)}`],
    ["Uploads stop below", size(storage.least_free)],
    ["Images are kept", retention === "keep" ? "for good" : retention === "until-published" ? "until their drive is published" : `${retention} days after publication`],
    ["Forecasts of the time left", held(eta)],
    ["Version", version],
  ];
  at("storage").replaceChildren(table(rows));
}

function showWork(work) {
  if (!work.length) return at("work").replaceChildren(element("p", "quiet", "No worker holds a job now."));
  const now = Date.now() / 1000;
  const rows = work.map((one) => [
    one.worker, one.part ? `${one.stage}, part ${one.part}` : one.stage, one.drive_id ? link(one.drive_name, "", `/drives/${one.drive_id}`) : "map",
    progress(one.progress, `${one.stage} of ${one.drive_name ?? "the map"}`), one.message, one.started_at ? duration(now - one.started_at) : "",
    one.heartbeat_at ? `${duration(Math.max(0, now - one.heartbeat_at))} ago` : "",
  ]);
  at("work").replaceChildren(table(rows, ["Worker", "Stage", "Drive", "Progress", "Doing", "For", "Heard of"]));
}

// None before the first drive, which begins the map.
async function mapJobs() {
  const { maps } = await ask("/v1/maps");
  return maps.some(({ id }) => id === info.map_id) ? ask(`/v1/maps/${info.map_id}/jobs?limit=${JOBS}`) : { jobs: [] };
}

const took = ({ state, started_at: from, finished_at: to }) => {
  if (!from || state === "queued") return "";
  return duration((state === "running" ? Date.now() / 1000 : to) - from);
};

function showMapJobs(jobs) {
  if (!jobs.length) return at("map-jobs").replaceChildren(element("p", "quiet", "Nothing was stitched or published yet."));
  const rows = jobs.map((one) => [
    moment(one.asked_at), one.parts ? `${one.stage}, ${many(one.parts, "part")}` : one.stage, element("span", `what ${one.state}`, one.state), moment(one.started_at), took(one),
    [one.version && `version ${one.version}`, one.attempt > 1 && `attempt ${one.attempt}`, one.losses && many(one.losses, "lost worker"), one.error ?? one.message].filter(Boolean).join(" · "),
  ]);
  at("map-jobs").replaceChildren(table(rows, ["Asked for", "Job", "State", "Begun", "Took", "What became of it"]));
}

function showVehicles(vehicles) {
  if (!vehicles.length) return at("vehicles").replaceChildren(element("p", "quiet", "No vehicle has sent a drive yet."));
  const rows = vehicles.map(({ id, drives, last_at: last, bytes, created_at: since }) => [
    id, String(Object.values(drives).reduce((sum, one) => sum + one, 0)), Object.entries(drives).map(([state, number]) => `${number} ${STATES[state]}`).join(", "),
    size(bytes), moment(last), moment(since),
  ]);
  at("vehicles").replaceChildren(table(rows, ["Vehicle", "Drives", "By state", "Sent", "Newest drive", "Known since"]));
}

async function refresh() {
  const mine = ++asked;
  const [fleet, { rigs }, { jobs }] = await Promise.all([ask("/v1/fleet"), ask("/v1/rigs"), mapJobs()]);
  if (mine !== asked) return;
  showQueues(fleet.queues);
  showStorage(fleet);
  showWork(fleet.work);
  showMapJobs(jobs);
  showVehicles(fleet.vehicles);
  const key = JSON.stringify(rigs);
  if (at("rigs").dataset.key === key) return;
  at("rigs").dataset.key = key;
  at("rigs").replaceChildren(...rigs.map(rigSection));
}

const renew = () => telling("list", refresh);
let waiting = null;
const soon = () => {
  waiting ??= setTimeout(async () => {
    waiting = null;
    await renew();
  }, WAIT_MS);
};

await renew();
setInterval(renew, RENEW_MS);
follow(soon, renew);
