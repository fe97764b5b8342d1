// The plots of a drive from its quality report: track, speed, residuals of its fixes, drift, uncertainty. Each says in a sentence what it shows.

import { chart } from "/static/drive/chart.js";

const rms = (values) => Math.sqrt(values.reduce((sum, one) => sum + one * one, 0) / Math.max(1, values.length));
const most = (values) => values.reduce((high, one) => Math.max(high, one), 0);
const spans = (bursts) => bursts.map((one) => [one.from_s, one.to_s]);
const fixed = (value, digits = 2) => value.toFixed(digits);

// km/h along the road, smoothed over a second or so; a thinned track still has its times and lengths.
export function speeds({ t_s: times, road_m: road }) {
  return times.map((_, k) => {
    const [from, to] = [Math.max(0, k - 5), Math.min(times.length - 1, k + 5)];
    return times[to] > times[from] ? (3.6 * (road[to] - road[from])) / (times[to] - times[from]) : NaN;
  });
}

function trackPlot({ track, bursts, placed, loops }) {
  const [x, y] = track.plane_m;
  const inBurst = (t) => bursts.some((one) => t >= one.from_s && t <= one.to_s);
  const shifted = track.t_s.map((t, k) => (inBurst(t) ? y[k] : NaN));
  const length = track.road_m.at(-1);
  return chart({
    title: "The track from above", text: `${fixed(length, 0)} m of road${loops ? `, ${loops.count} loop closures` : ""}.`, equal: true, place: "keyframe that is shown",
    x: { label: placed ? "east (m)" : "right of the start (m)", values: x }, y: { label: placed ? "north (m)" : "ahead of the start (m)" },
    series: [
      { name: "track", values: y, style: "one" }, { name: "GNSS burst", values: shifted, kind: "dots", style: "bad" },
      { name: "start", x: x.slice(0, 1), values: y.slice(0, 1), kind: "dots", style: "start" },
    ],
  });
}

function speedPlot({ track, bursts }) {
  const values = speeds(track);
  const known = values.filter(Number.isFinite);
  return chart({
    title: "Speed", text: `Mean ${fixed((3.6 * track.road_m.at(-1)) / (track.t_s.at(-1) || 1), 0)} km/h, most ${fixed(most(known), 0)} km/h.`,
    x: { label: "time (s)", values: track.t_s }, y: { label: "km/h", from0: true }, bands: spans(bursts), band: "GNSS burst",
    series: [{ name: "speed by the odometry", values, style: "one" }],
  });
}

function residualPlot({ fixes, bursts }) {
  const across = fixes.residual_enu_m[0].map((east, k) => Math.hypot(east, fixes.residual_enu_m[1][k]));
  const pick = (wanted, values) => values.map((value, k) => (fixes.used[k] === wanted ? value : NaN));
  const up = fixes.residual_enu_m[2].map(Math.abs);
  const used = across.filter((_, k) => fixes.used[k]);
  const limit = Math.max(0.05, 1.3 * most(used));
  return chart({
    title: "GNSS residuals", limit,
    text: `Fix minus antenna: ${fixed(rms(used))} m RMS across for ${used.length} fixes that are used; ${across.length - used.length} are not. What lies beyond the axis is drawn at its edge.`,
    x: { label: "time (s)", values: fixes.t_s }, y: { label: "m", from0: true }, bands: spans(bursts), band: "GNSS burst",
    series: [
      { name: "across, used", values: pick(true, across), kind: "dots", style: "one" },
      { name: "up, used", values: pick(true, up), kind: "dots", style: "two" },
      { name: "across, not used", values: pick(false, across), kind: "crosses", style: "bad" },
    ],
  });
}

function driftPlot({ drift, track }) {
  return chart({
    title: "Drift of the odometry alone",
    text: `${fixed(drift.percent.median)} % of the road in the median, ${fixed(drift.percent.worst)} % at worst; ${fixed(rms(drift.odometry_m))} m RMS from the result.`,
    x: { label: "road (m)", values: drift.road_m }, y: { label: "m", from0: true },
    series: [{ name: "odometry alone, from the result", values: drift.odometry_m, style: "two" }, ...sigmaLine(track)],
  });
}

const sigmaLine = ({ sigma, road_m: road }) =>
  sigma ? [{ name: "σ of the result", x: road, values: sigma.enu_m[0].map((east, k) => Math.hypot(east, sigma.enu_m[1][k], sigma.enu_m[2][k])), style: "one" }] : [];

function sigmaPlot({ track }) {
  const [east, north, up] = track.sigma.enu_m;
  const across = east.map((one, k) => Math.hypot(one, north[k]));
  return chart({
    title: "Uncertainty along the road", text: `One sigma across: ${fixed(most(across))} m at worst; up: ${fixed(most(up))} m; heading: ${fixed(most(track.sigma.heading_deg))}°.`,
    x: { label: "road (m)", values: track.road_m }, y: { label: "σ (m, °)", from0: true },
    series: [
      { name: "across (m)", values: across, style: "one" }, { name: "up (m)", values: up, style: "two" },
      { name: "heading (°)", values: track.sigma.heading_deg, style: "three" },
    ],
  });
}

// The plots that a quality report allows, by name: { title, text, figure, mark }.
export function plotsOf(quality) {
  const made = { track: trackPlot, speed: speedPlot, ...(quality.fixes ? { residuals: residualPlot } : {}), ...(quality.drift ? { drift: driftPlot } : {}), ...(quality.track.sigma ? { sigma: sigmaPlot } : {}) };
  return Object.fromEntries(Object.entries(made).map(([name, draw]) => [name, draw(quality)]));
}
