// A line chart as SVG: axes, series, bands and marks; its title and a sentence for those who do not see it, its numbers under the pointer.

import { element, svg } from "/static/ui/dom.js";

// On a narrow screen as many units as there are pixels, or its words would be too small to read.
const [WIDTH, HEIGHT] = [matchMedia("(max-width: 800px)").matches ? 380 : 720, 220];
const EDGE = { left: 52, right: 12, top: 12, bottom: 34 };

// Round steps for an axis of so many ticks.
export function ticks(low, high, count = 5) {
  const raw = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw);
  const found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + step * 1e-6; at += step) found.push(Number(at.toPrecision(10)));
  return found;
}

const range = (values) => values.reduce(([low, high], one) => [Math.min(low, one), Math.max(high, one)], [Infinity, -Infinity]);
const finite = (value) => Number.isFinite(value);

// about: { title, text, x: { label, values }, y: { label, from0 }, series: [{ name, values, kind: line | dots | crosses, style, x }], bands:
// [[from, to]], band: what they are, place: what is marked, equal }. Of `equal`, both axes have one scale, as of a track. Returns a figure; mark(x, y) shows a place on it, null none.
export function chart(about) {
  const height = about.equal ? 380 : HEIGHT;
  const figure = element("figure", "chart");
  const root = svg("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img" });
  root.append(svg("title", {}, about.title), svg("desc", {}, about.text));
  const series = about.series.filter(({ values }) => values.some(finite));
  const xs = series.flatMap((one) => one.x ?? about.x.values).filter(finite);
  const ys = series.flatMap((one) => one.values).filter(finite);
  if (!xs.length) return { figure: element("p", "quiet", `${about.title}: nothing is known.`), mark: () => {}, title: about.title, text: about.text };
  let [x0, x1] = range(xs);
  let [y0, y1] = range(ys);
  if (about.y.from0) y0 = Math.min(0, y0);
  if (about.limit) [y0, y1] = [Math.max(y0, -about.limit), Math.min(y1, about.limit)];
  const slack = 0.06 * (y1 - y0 || Math.abs(y1) || 1);
  [y0, y1] = [about.y.from0 && y0 >= 0 ? y0 : y0 - slack, y1 + slack];
  if (x1 === x0) x1 = x0 + 1;
  const room = [WIDTH - EDGE.left - EDGE.right, height - EDGE.top - EDGE.bottom];
  if (about.equal) {
    const scale = Math.min(room[0] / (x1 - x0 || 1), room[1] / (y1 - y0 || 1)) * 0.95;
    [[x0, x1], [y0, y1]] = [[x0, x1, room[0]], [y0, y1, room[1]]].map(([low, high, wide]) => [(low + high - wide / scale) / 2, (low + high + wide / scale) / 2]);
  }
  const X = (value) => EDGE.left + ((value - x0) / (x1 - x0)) * room[0];
  const Y = (value) => EDGE.top + (1 - (Math.max(y0, Math.min(y1, value)) - y0) / (y1 - y0)) * room[1];
  const grid = svg("g", { class: "grid" });
  for (const at of ticks(x0, x1, WIDTH / 90)) {
    grid.append(svg("line", { x1: X(at), x2: X(at), y1: EDGE.top, y2: height - EDGE.bottom }));
    grid.append(svg("text", { x: X(at), y: height - EDGE.bottom + 14, "text-anchor": "middle" }, String(at)));
  }
  for (const at of ticks(y0, y1, 4)) {
    grid.append(svg("line", { x1: EDGE.left, x2: WIDTH - EDGE.right, y1: Y(at), y2: Y(at) }));
    grid.append(svg("text", { x: EDGE.left - 6, y: Y(at) + 4, "text-anchor": "end" }, String(at)));
  }
  grid.append(svg("text", { x: EDGE.left + room[0] / 2, y: height - 4, "text-anchor": "middle" }, about.x.label));
  grid.append(svg("text", { transform: `translate(11 ${EDGE.top + room[1] / 2}) rotate(-90)`, "text-anchor": "middle" }, about.y.label));
  root.append(grid);
  for (const [from, to] of about.bands ?? []) {
    root.append(svg("rect", { class: "band", x: X(from), width: Math.max(1, X(to) - X(from)), y: EDGE.top, height: room[1] }));
  }
  series.forEach((one) => root.append(drawn(one, one.x ?? about.x.values, X, Y)));
  const dot = svg("circle", { class: "here", r: 5, visibility: "hidden" });
  root.append(dot);
  const place = entry(svg("circle", { class: "here", r: 4, cx: 11, cy: 5 }), about.place ?? "");
  place.hidden = true;
  const band = about.bands?.length ? [entry(svg("rect", { class: "band", width: 22, height: 10 }), about.band)] : [];
  figure.append(root, legend(series, [...band, place]));
  const mark = (x, y) => {
    place.hidden = !finite(x) || !finite(y);
    dot.setAttribute("visibility", finite(x) && finite(y) ? "visible" : "hidden");
    if (!finite(x) || !finite(y)) return;
    dot.setAttribute("cx", X(x));
    dot.setAttribute("cy", Y(y));
  };
  return { title: about.title, text: about.text, figure, mark };
}

function drawn({ values, kind = "line", style }, xs, X, Y) {
  if (kind === "line") {
    const cut = values.map((value, k) => (finite(value) ? `${X(xs[k]).toFixed(1)},${Y(value).toFixed(1)}` : null));
    return svg("polyline", { class: `line ${style}`, points: cut.filter(Boolean).join(" ") });
  }
  const path = values.map((value, k) => {
    if (!finite(value)) return "";
    const [x, y] = [X(xs[k]).toFixed(1), Y(value).toFixed(1)];
    return kind === "dots" ? `M${x} ${y}h.01` : `M${x - 3} ${y - 3}l6 6m0 -6l-6 6`;
  });
  return svg("path", { class: `${kind} ${style}`, d: path.join("") });
}

function legend(series, more) {
  const list = element("figcaption");
  list.append(...series.map(({ name, style, kind = "line" }) =>
    entry(drawn({ values: kind === "line" ? [0, 0] : [0], kind, style }, kind === "line" ? [0, 22] : [11], (x) => x, () => 5), name),
  ), ...more);
  return list;
}

// What is drawn of 22 by 10 units, and what it means.
function entry(sign, words) {
  const one = element("span");
  const sample = svg("svg", { viewBox: "0 0 22 10", width: 22, height: 10, "aria-hidden": "true" });
  sample.append(sign);
  one.append(sample, ` ${words}`);
  return one;
}
