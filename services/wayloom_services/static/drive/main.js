// The page of one drive: its grade with reasons and warnings, what an operator does with it, its plots, keyframes, log and downloads.

import { ask, blobOf, giveUp, headers } from "/static/api.js";
import { Scrubber } from "/static/drive/keyframes.js";
import { showHistory, showStages } from "/static/drive/log.js";
import { numbers } from "/static/drive/numbers.js";
import { plotsOf } from "/static/drive/plots.js";
import { verdict } from "/static/drive/verdict.js";
import { waysOut } from "/static/drive/ways_out.js";
import { gradeBadge } from "/static/list/card.js";
import { actionsFor, deleteDrive } from "/static/ui/actions.js";
import { at, button, element, link, say, table } from "/static/ui/dom.js";
import { announce, follow, frame, telling } from "/static/ui/frame.js";
import { driveWords, duration, errorOf, moment, OVER, STATES } from "/static/ui/words.js";

const id = location.pathname.split("/").pop();
const RENEW_MS = 10_000;
const RENEW_GOING_MS = 60_000; // seldom: a browser complains of what is gone
const SAVING_MS = 60_000;
const MISSING = [404, 422]; // of an id that nobody has, and of what is no id
const RUNS = { running: "Being processed anew", publishing: "Processed anew, joining the map", failed: "Processing anew failed" };

const [info, caller] = await Promise.all([ask("/v1/info"), frame()]);
const mayOperate = caller.rights.includes("operate");
const about = { caller, models: info.models, remove };
let shown = null;
let quality = null;
let plots = {};
let isRemoved = false;
const scrubber = new Scrubber(id, mayOperate, (seconds) => markAt(seconds));

function showVerdict(drive) {
  at("verdict-box").hidden = !drive.quality;
  at("grade").replaceChildren(gradeBadge(drive.quality));
  if (!drive.quality) return;
  const { gate, reasons, release, by_map: byMap } = drive.quality;
  at("verdict").textContent = verdict(drive);
  at("by-map").hidden = !byMap;
  if (byMap) at("by-map").textContent = `The map says: ${byMap.reason}.`;
  at("reasons").replaceChildren(...reasons.map((reason) => element("li", "", reason)));
  const ways = waysOut(drive, about);
  at("ways").hidden = !ways.length;
  at("ways-out").replaceChildren(...ways);
  at("release").hidden = !release;
  at("revoke").hidden = !release || !mayOperate;
  if (release) at("release").textContent = `Released by ${release.by} on ${moment(release.at)}: ${release.why}`;
  at("ask-release").hidden = !mayOperate || release !== null || gate === "merge" || drive.placed === false;
}

// What is said of a new run; the rest of the page is of the result before.
function showRun({ stage, reprocess }) {
  at("anew").hidden = !reprocess;
  if (!reprocess) return;
  const more = reprocess.error ?? (reprocess.state === "running" && stage ? stage : "");
  at("anew").textContent = `${RUNS[reprocess.state]}${more ? `: ${more}` : ""}. This page shows the result before.`;
}

function showProgress(drive) {
  const over = OVER.includes(drive.state) && !drive.reprocess;
  at("progress").hidden = over;
  say(at("words"), driveWords(drive));
  at("bars").replaceChildren(
    ...drive.stages.map((stage) => {
      const bar = element("span", stage.state);
      bar.title = `${stage.stage}: ${stage.state}${stage.seconds === null ? "" : `, ${duration(stage.seconds)}`}`;
      const fill = element("b");
      fill.style.width = `${100 * stage.progress}%`;
      bar.append(fill);
      return bar;
    }),
  );
  at("bars").ariaLabel = `${Math.round(100 * drive.progress)} % of all stages`;
}

function showActions(drive) {
  const actions = actionsFor(drive, about).filter(({ id: name }) => !["release", "revoke"].includes(name));
  const key = actions.map(({ id: name }) => name).join();
  if (at("actions").dataset.key === key) return;
  at("actions").dataset.key = key;
  const had = at("actions").contains(document.activeElement) ? document.activeElement.id : null;
  at("actions").replaceChildren(
    ...actions.map(({ id: name, label, danger }) => {
      const one = button(label, danger ? "danger" : "", () => act(() => actionsFor(shown, about).find((found) => found.id === name)?.run()));
      one.id = name;
      return one;
    }),
  );
  if (had) (at(had) ?? at("actions").firstElementChild)?.focus();
}

const act = (work) =>
  telling("act", async () => {
    await work();
    if (!isRemoved && !isGoing()) await refresh();
  });

// Deletes the drive. What is asked about it is given up before: it may be gone by the time of the answer.
async function remove(drive) {
  scrubber.stop();
  giveUp();
  try {
    const going = await deleteDrive(drive);
    if (!isRemoved) show(going);
  } catch (error) {
    shown = null; // all that was given up is asked for again
    renew();
    throw error;
  }
}

function showDownloads(drive) {
  const axes = drive.placed === false ? "Right, ahead, up of the drive's start: it has no place on Earth" : "East, north, up in the map's frame";
  const files = [
    ["Report, a page that stands by itself", "report.html", Boolean(drive.facts.quality), "Opens in a tab"],
    ["Track, GeoJSON", "track", drive.placed === true, "Longitude, latitude, height in WGS84"],
    ["Keyframe poses, TUM", "trajectory.tum", Boolean(drive.facts.preview), axes],
    ["Labelled points, PLY", "cloud.ply", Boolean(drive.facts.preview), "With class, sigma and time"],
    ["All of these in one archive, zip", "archive.zip", Boolean(drive.facts.preview), "With objects, pictures of the ground, and a README that says what is what"],
    ["Log as it was sent, tar", "log.tar", mayOperate && drive.images.state === "kept" && drive.uploaded_at !== null, "Images and all; for operators"],
  ];
  const key = JSON.stringify([drive.name, axes, files.map(([, , has]) => has)]);
  if (at("downloads").dataset.key === key) return;
  at("downloads").dataset.key = key;
  const had = at("downloads").contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
  at("downloads").replaceChildren(
    ...files.filter(([, , has]) => has).map(([text, name, , hint]) => {
      const item = element("li");
      const one = link(text, "", `/v1/drives/${id}/${name}`);
      if (name === "report.html") one.target = "_blank";
      else one.download = name === "track" ? `${drive.name}.geojson` : "";
      if (headers().Authorization) one.addEventListener("click", (event) => (event.preventDefault(), telling("download", () => byKey(one))));
      item.append(one, element("span", "quiet", ` ${hint}`));
      return item;
    }),
  );
  if (had) [...at("downloads").querySelectorAll("a")].find((one) => one.getAttribute("href") === had)?.focus();
  if (!at("downloads").children.length) at("downloads").append(element("li", "quiet", "Nothing yet: the drive is not processed."));
}

// A link sends no key: what it leads to is fetched with it, and saved.
async function byKey(one) {
  const url = URL.createObjectURL(await blobOf(one.href));
  const saved = link("", "", url);
  saved.download = one.download || `${shown.name}-${one.href.split("/").pop()}`;
  saved.click();
  setTimeout(() => URL.revokeObjectURL(url), SAVING_MS);
}

function show(drive) {
  const before = shown;
  shown = drive;
  document.title = `${drive.name} · wayloom`;
  say(at("name"), drive.name);
  say(at("state"), STATES[drive.state]);
  say(at("vehicle"), drive.vehicle_id ? `vehicle ${drive.vehicle_id}` : "");
  say(at("error"), errorOf(drive));
  at("doubts").hidden = !drive.warnings.length;
  at("warnings").replaceChildren(...drive.warnings.map((text) => element("li", "", text)));
  showVerdict(drive);
  showRun(drive);
  showProgress(drive);
  showActions(drive);
  showDownloads(drive);
  showStages(drive);
  if (before && before.state !== drive.state) announce(`${drive.name}: ${STATES[drive.state]}`);
  const news = [before?.facts.quality !== drive.facts.quality, before?.facts.preview !== drive.facts.preview, before?.images.state !== drive.images.state];
  if (news[0] && drive.facts.quality) telling("quality", showQuality);
  if ((news[1] || news[2]) && drive.facts.preview) telling("keyframes", () => scrubber.load());
  if (drive.state === "removing") return; // its history goes with it
  if (!before || before.stages.map((one) => one.state).join() !== drive.stages.map((one) => one.state).join()) telling("history", () => showHistory(id));
}

async function showQuality() {
  const report = shown.facts.quality;
  const found = await ask(`/v1/drives/${id}/quality`);
  if (report !== shown.facts.quality) return;
  quality = found;
  at("numbers").replaceChildren(table(numbers(quality, shown.facts)));
  if (!quality.track) return showPictures();
  plots = plotsOf(quality);
  at("track-box").hidden = false;
  at("track").replaceChildren(plots.track.figure, element("p", "quiet", plots.track.text));
  at("plots").replaceChildren(
    ...Object.entries(plots).filter(([name]) => name !== "track").map(([name, { figure, title, text }]) => {
      const section = element("section");
      section.dataset.plot = name;
      section.ariaLabel = title;
      section.append(element("h2", "", title), figure, element("p", "quiet", text));
      return section;
    }),
  );
}

// Of a report without series: its pictures as the server drew them.
async function showPictures() {
  at("pictures").replaceChildren(
    ...(await Promise.all(
      quality.pictures.map(async (name) => {
        const url = URL.createObjectURL(await blobOf(`/v1/drives/${id}/quality/${name}.svg`));
        const image = element("img", "plot");
        image.alt = name;
        image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
        image.src = url;
        const section = element("section");
        section.append(image);
        return section;
      }),
    )),
  );
}

// The place of a keyframe on the track, by its time.
function markAt(seconds) {
  if (!quality?.track || !plots.track) return;
  const { t_s: times, plane_m: [x, y] } = quality.track;
  const k = times.findIndex((time) => time >= seconds);
  const row = k < 0 ? times.length - 1 : k;
  plots.track.mark(x[row], y[row]);
}

async function refresh() {
  const found = await ask(`/v1/drives/${id}`).catch((error) => {
    if (!MISSING.includes(error.status)) throw error;
  });
  if (isRemoved) return;
  if (!found && shown) return removed();
  missing(!found);
  if (found) show(found);
}

function missing(isMissing) {
  at("none").hidden = !isMissing;
  at("main").classList.toggle("is-missing", isMissing);
  if (isMissing) document.title = "No such drive · wayloom";
}

function removed() {
  isRemoved = true;
  at("none").querySelector("h1").textContent = "This drive was removed";
  at("none").querySelector("p").textContent = "Its files are gone; its part of the map goes with the next version.";
  missing(true);
}

at("ask-release").addEventListener("submit", (event) => {
  event.preventDefault();
  act(() => ask(`/v1/drives/${id}/release`, { method: "POST", body: JSON.stringify({ by: at("by").value, why: at("why").value }) }));
});
at("revoke").addEventListener("click", () => act(() => ask(`/v1/drives/${id}/release`, { method: "DELETE" })));
at("by").value = caller.name === "this machine" ? "" : caller.name.replace(/^user /, "");

function hear(event, data) {
  if (event === "drive" && data.id === id) {
    isRemoved = false;
    missing(false);
    show(data);
  }
  if (event === "removed" && data.id === id) removed();
}

const renew = () => telling("drive", refresh);
const isGoing = () => shown?.state === "removing";
const isAtWork = () => shown && !isGoing() && (!OVER.includes(shown.state) || shown.reprocess);

await renew();
// The stream tells of the newest drives alone.
setInterval(() => isAtWork() && !isRemoved && renew(), RENEW_MS);
setInterval(() => isGoing() && !isRemoved && renew(), RENEW_GOING_MS);
follow(hear, renew);
