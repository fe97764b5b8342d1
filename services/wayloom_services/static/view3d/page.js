// The 3D page: points of the map with level of detail, coloured as asked, flown along a drive; its view is in its address.

import { ask } from "/static/api.js";
import { at, element } from "/static/ui/dom.js";
import { numbersOf, readHash, writeHash } from "/static/map/hash.js";
import { zoomOf } from "/static/map/scale.js";
import { BESIDE_M, sitesOf, wider } from "/static/map/sites.js";
import { follow, frame } from "/static/ui/frame.js";
import { many } from "/static/ui/words.js";
import { MODES } from "/static/view3d/colours.js";
import { Flight, wayOf } from "/static/view3d/fly.js";
import { Panel } from "/static/view3d/panel.js";
import { tellPoint } from "/static/view3d/point.js";
import { PointScene } from "/static/view3d/scene.js";

const STATIC = "static";
// What the panel leaves of a wide window.
const FREE_SHARE = 0.8;
const NARROW_PX = 700;
const state = { colour: "class", hidden: new Set(), layers: new Set(), size: 2, detail: 3, drive: "", version: null };
let found = null;
let sites = [];
let scene = null;
let flight = null;
let panel = null;
let placed = false;
let downAt = [0, 0];
let lastRange = "";
let waiting = 0;
let restoring = 0;
let showing = Promise.resolve();
let newest = 0;

const [info] = await Promise.all([ask("/v1/info"), frame()]);
function begin() {
  scene = new PointScene(at("view"), info.classes, {
    moved: (by) => (by === "hand" && flight?.flying && flight.stop(), keepAddress()), drawn: told, failed: tellFailed,
  });
  flight = new Flight(scene, (share, flying) => panel.flown(share, flying));
  panel = new Panel(at, info, { change, fly, goTo: (share) => flight.goTo(share), speed: (value) => (flight.speed = value), save, fit, site: goToSite, north: () => scene.orbit.place({ bearing: 0 }) });
  globalThis.wayloom3d = { scene, flight, state };
  at("view").addEventListener("click", (event) => pick(event.clientX, event.clientY));
  at("view").addEventListener("pointerdown", (event) => (downAt = [event.clientX, event.clientY]));
  at("newest").addEventListener("click", () => showNewest().then(() => at("view").focus()).catch(tellFailed));
  addEventListener("keydown", keys);
  addEventListener("popstate", () => restore().catch(tellFailed));
  restore().catch(tellFailed);
  follow(hear);
}

function pick(x, y) {
  if (Math.hypot(x - downAt[0], y - downAt[1]) > 4) return;
  const point = scene.pick(x, y);
  tellPoint(at("picked"), point, { info, version: found?.version, frame: scene.frame, back: () => at("view").focus() });
}

function closeCard() {
  const hadFocus = at("picked").contains(document.activeElement);
  at("picked").hidden = true;
  if (hadFocus) at("view").focus();
}

function keys(event) {
  if (event.key === "Escape") return closeCard();
  if (event.target.closest("input, select, textarea, button, a, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "f") fit();
  else if (event.key === "m") location.assign(at("to-map").href);
  else if (event.key === "s") save();
  else if (event.key === " ") fly();
  else if (event.key === "Enter" && event.target === at("view")) {
    const box = at("view").getBoundingClientRect();
    downAt = [box.left + box.width / 2, box.top + box.height / 2];
    pick(...downAt);
    at("picked").focus();
  } else return;
  event.preventDefault();
}

// The state that the address names, then what it shows.
async function restore() {
  const words = readHash();
  const list = (name) => new Set((words.get(name) ?? "").split(",").filter(Boolean));
  Object.assign(state, {
    colour: MODES.includes(words.get("colour")) ? words.get("colour") : "class", hidden: list("hide"), layers: list("also"),
    size: Number(words.get("size")) || 2, detail: Number(words.get("detail")) || 3, drive: words.get("drive") ?? "",
    version: Number(words.get("v")) || null,
  });
  panel.show(state);
  const mine = ++restoring;
  await showVersion();
  if (mine !== restoring) return;
  const place = numbersOf(words.get("at"), 3);
  const view = numbersOf(words.get("view"), 3);
  placed = place !== null;
  if (place && scene.frame) {
    const [distance, bearing, tilt] = view ?? [120, 0, 40];
    scene.orbit.place({ target: scene.frame.local(...place), distance, bearing, tilt });
  } else if (numbersOf(words.get("at"), 2)) {
    goTo(...numbersOf(words.get("at"), 2), Number(words.get("distance")) || 120);
  }
  for (const { id, name } of info.classes) scene.show(id, !state.hidden.has(name));
  scene.size(state.size);
  recolour();
  await chooseDrive();
}

// One after the other: a version stands in the frame that the first one gave.
function showVersion() {
  showing = showing.catch(() => null).then(showOne);
  return showing;
}

async function showOne() {
  const { version: wanted } = state;
  const path = wanted === null ? `/v1/maps/${info.map_id}` : `/v1/maps/${info.map_id}/versions/${wanted}`;
  const next = await ask(path).catch((error) => {
    if (wanted !== null && [404, 410].includes(error.status)) tell(`Version ${wanted} is not kept any more`, ["Its time is over, or it was withdrawn. The button above shows the newest."]);
    else if (error.status === 404) tell("Nothing to show yet", ["Send a drive; this page shows the map as soon as it is published."]);
    else throw error;
  });
  if (!next || wanted !== state.version) return;
  at("message").hidden = true;
  offerNewest();
  const first = found === null;
  const isNew = found?.version !== next.version;
  found = next;
  at("version").textContent = `${found.map_id} · version ${found.version}`;
  if (first) await standSomewhere();
  panel.layers(info.overlays.filter((name) => found.layers[`${name}-tilesets`]), state);
  const base = `/v1/maps/${found.map_id}/versions/${found.version}/3dtiles`;
  const trees = new Map([[STATIC, `${base}/tileset.json`], ...[...state.layers].filter((name) => found.layers[`${name}-tilesets`]).map((name) => [name, `${base}/${name}/tileset.json`])]);
  for (const name of scene.trees.keys()) if (!trees.has(name)) scene.remove(name);
  await Promise.all([...trees].filter(([name]) => isNew || !(scene.trees.has(name) || scene.coming.has(name))).map(([name, address]) => scene.add(name, address)));
}

// The frame of the view, around the map's largest site.
async function standSomewhere() {
  const coverage = await ask(`/v1/maps/${found.map_id}/coverage`).catch(() => ({ features: [] }));
  sites = sitesOf(coverage.features);
  const [west, south, east, north] = sites[0]?.bounds ?? found.bounds ?? [found.frame[0], found.frame[1], found.frame[0], found.frame[1]];
  scene.standAt([(west + east) / 2, (south + north) / 2, found.frame[2]], found.frame);
  panel.sites(sites);
  fit();
}

function fit(site = sites[0]) {
  const bounds = site?.bounds ?? found?.bounds;
  if (!bounds || !scene.frame) return;
  const [west, south, east, north] = wider(bounds, BESIDE_M);
  const corners = [scene.frame.local(west, south, found.frame[2]), scene.frame.local(east, north, found.frame[2])];
  const middle = corners[0].clone().add(corners[1]).multiplyScalar(0.5);
  const ground = scene.groundAt(middle.x, middle.y);
  if (ground !== null) middle.z = ground;
  const [wide, deep] = [Math.abs(corners[1].x - corners[0].x), Math.abs(corners[1].y - corners[0].y)];
  const steep = Math.tan((scene.camera.fov * Math.PI) / 360);
  const free = innerWidth < NARROW_PX ? 1 : FREE_SHARE;
  const across = wide / 2 / (steep * (innerWidth / innerHeight) * free);
  const distance = (deep / 4) * Math.SQRT1_2 + Math.max(across, ((deep / 2) * Math.SQRT1_2) / steep);
  scene.orbit.place({ target: middle, distance: Math.max(distance, 30), bearing: 0, tilt: 45 });
}

function goToSite(number) {
  fit(sites[number]);
}

function goTo(lon, lat, distance) {
  if (!scene.frame) return;
  scene.orbit.place({ target: scene.frame.local(lon, lat, found.frame[2]), distance, bearing: 0, tilt: 45 });
}

// By the panel. step: a choice that the back button undoes.
async function change(more, step = true) {
  Object.assign(state, more);
  if ("hidden" in more) for (const { id, name } of info.classes) scene.show(id, !state.hidden.has(name));
  if ("size" in more) scene.size(state.size);
  if ("detail" in more) recolour();
  if ("colour" in more) recolour();
  if ("layers" in more) await showVersion();
  if ("drive" in more) await chooseDrive();
  keepAddress(step);
}

function recolour() {
  scene.detailPx = (scene.isSoftware ? 12 : 6) * 2 ** (3 - state.detail);
  const range = state.colour === "class" ? [0, 1] : scene.rangeOf(state.colour);
  scene.colour(state.colour, range);
  panel.ramp(state.colour, range, found?.frame[2] ?? 0);
}

async function chooseDrive() {
  const { drive } = state;
  const feature = drive && (await ask(`/v1/drives/${drive}/track`).catch(() => null));
  if (drive !== state.drive) return; // another one was chosen meanwhile
  at("way").hidden = !feature?.geometry || !scene.frame;
  if (at("way").hidden) {
    scene.line(null);
    flight.take([]);
    return;
  }
  const { type, coordinates } = feature.geometry;
  const places = (type === "LineString" ? coordinates : coordinates.flat()).map(([lon, lat, height]) => scene.frame.local(lon, lat, height ?? found.frame[2]));
  if (coordinates.flat(2).length && (type === "LineString" ? coordinates[0] : coordinates[0][0]).length < 3) places.forEach((place) => (place.z = scene.groundAt(place.x, place.y) ?? place.z));
  scene.line(places);
  flight.take(wayOf(places));
}

function fly() {
  if (flight.flying) flight.stop();
  else flight.start();
}

async function save() {
  const link = element("a");
  link.href = URL.createObjectURL(await scene.picture());
  link.download = `wayloom-${found?.map_id ?? "map"}-${found?.version ?? 0}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// After each frame: what is there, and, when all has come, the colours over what is drawn.
function told() {
  if (!panel) return;
  const settled = scene.isSettled;
  at("status-words").textContent = `${many(scene.points, "point")}${settled ? "" : " · loading"}`;
  panel.classes(scene.classesHere(), state);
  if (!placed && scene.points && scene.frame) {
    placed = true;
    const { target } = scene.orbit;
    const ground = scene.groundAt(target.x, target.y);
    if (ground !== null) scene.orbit.place({ target: target.clone().setZ(ground) });
  }
  const key = `${state.colour} ${[...scene.tiles()].length} ${found?.version}`;
  if (settled && state.colour !== "class" && key !== lastRange) {
    lastRange = key;
    recolour();
  }
}

function keepAddress(step = false) {
  clearTimeout(waiting);
  if (step) return void writeAddress(true);
  waiting = setTimeout(() => writeAddress(false), 250);
}

function writeAddress(step) {
  if (!scene.frame) return;
  const { orbit } = scene;
  const [lon, lat, height] = scene.frame.geographic(orbit.target);
  const list = (values) => [...values].sort().join(",");
  writeHash({
    at: [lon.toFixed(7), lat.toFixed(7), height.toFixed(1)].join(","),
    view: [orbit.distance.toFixed(1), orbit.bearing.toFixed(0), orbit.tilt.toFixed(0)].join(","),
    colour: state.colour === "class" ? "" : state.colour, hide: list(state.hidden), also: list(state.layers),
    size: state.size === 2 ? "" : state.size, detail: state.detail === 3 ? "" : state.detail, drive: state.drive, v: state.version,
  }, step);
  // Zoom of the map at which as many metres are seen from top to bottom.
  const metres = (2 * orbit.distance * Math.tan((scene.camera.fov * Math.PI) / 360)) / at("view").clientHeight;
  const zoom = zoomOf(lat, metres);
  const more = [state.version && `v=${state.version}`, state.drive && `drive=${state.drive}`].filter(Boolean).map((one) => `&${one}`).join("");
  at("to-map").href = `/#at=${lon.toFixed(7)},${lat.toFixed(7)},${Math.min(zoom, 22).toFixed(2)}${more}`;
}

function hear(event, data) {
  if (event === "map" && data.id === info.map_id && data.version) hearVersion(data.version);
  if (event === "drive" && data.placed) panel.drive(data, state);
  if (event === "removed") panel.forget(data.id);
}

// A version that was asked for by the address stays until the newest is; before the first one there is nothing of the address to see yet.
function hearVersion(number) {
  newest = number;
  offerNewest();
  if (found === null) restore().catch(tellFailed);
  else if (state.version === null && number !== found.version) showVersion().catch(tellFailed);
}

function offerNewest() {
  at("newest").hidden = state.version === null || newest <= state.version;
  at("newest").textContent = `Show the newest, version ${newest}`;
}

async function showNewest() {
  state.version = null;
  offerNewest();
  await showVersion();
  keepAddress(true);
}

function tell(title, lines) {
  at("message").hidden = false;
  const list = element("ul");
  list.append(...lines.map((line) => element("li", "", line)));
  at("message").replaceChildren(element("h2", "", title), list);
}

function tellFailed(error) {
  at("status-words").textContent = `a part did not come: ${error.message}`;
}

function tellNoWebGL(error) {
  console.info(error.message);
  at("panel").hidden = true;
  at("status").hidden = true;
  tell("This browser draws no 3D", [
    "It has no WebGL 2, or it is switched off: turn on hardware acceleration in its settings, or try a current Firefox, Chrome, Edge or Safari.",
    "On a machine without a graphics card, Chrome draws in software when it is started with --enable-unsafe-swiftshader.",
    "Without it: `wayloom export --format copc` writes the points for QGIS or CloudCompare.",
  ]);
}

try {
  begin();
} catch (error) {
  tellNoWebGL(error);
}
