// The 3D scene: a canvas that is drawn when something has changed, the tiles of a version, and what lies under the pointer.

import {
  BufferAttribute, BufferGeometry, Color, Line, LineBasicMaterial, Matrix4, PerspectiveCamera, Scene, Vector3, WebGLRenderer,
} from "/static/vendor/three/three.bundle.mjs";
import { Orbit } from "/static/view3d/camera.js";
import { whenSchemeChanges } from "/static/ui/tones.js";
import { pointMaterial, setMode, setTones, showClass } from "/static/view3d/colours.js";
import { LocalFrame } from "/static/view3d/geo.js";
import { TileTree } from "/static/view3d/tiles.js";

const FOV = 50;
const RAD = Math.PI / 180;
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;
const MOST_POINTS = { hardware: 3_000_000, software: 600_000 };

export class PointScene {
  // moved(by): the view has changed. drawn(): a frame is there. failed(error).
  // Throws an Error where the browser has no WebGL 2.
  constructor(canvas, classes, { moved, drawn, failed }) {
    Object.assign(this, { canvas, drawn, failed });
    this.renderer = new WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: false, powerPreference: "high-performance" });
    const gl = this.renderer.getContext();
    const named = gl.getExtension("WEBGL_debug_renderer_info");
    this.isSoftware = SOFTWARE.test(named ? gl.getParameter(named.UNMASKED_RENDERER_WEBGL) : "");
    this.renderer.setPixelRatio(this.isSoftware ? 1 : Math.min(devicePixelRatio, 2));
    this.camera = new PerspectiveCamera(FOV, 1, 0.1, 3000);
    this.scene = new Scene();
    this.material = pointMaterial(classes);
    this.orbit = new Orbit(this.camera, canvas, (by) => (moved(by), this.redraw()));
    this.frame = null;
    this.trees = new Map();
    this.coming = new Map();
    this.way = null;
    this.detailPx = this.isSoftware ? 12 : 6;
    this.budget = this.isSoftware ? MOST_POINTS.software : MOST_POINTS.hardware;
    this.frames = [];
    this.asked = false;
    new ResizeObserver(() => this.#resize()).observe(canvas.parentElement);
    canvas.addEventListener("webglcontextrestored", () => this.redraw());
    whenSchemeChanges(() => {
      setTones(this.material, classes);
      this.redraw();
    });
  }

  // The tangent plane in which all is drawn from now on.
  standAt(anchor, mapFrame) {
    for (const name of [...this.trees.keys()]) this.remove(name);
    this.frame = new LocalFrame(anchor, mapFrame);
  }

  // Shows a tileset under a name; what was under it goes when the new one has points, so that nothing blinks.
  async add(name, address) {
    const tree = new TileTree(address, {
      frame: this.frame, into: this.scene, material: this.material, failed: this.failed,
      changed: () => (this.#take(name), this.redraw()),
    });
    this.coming.get(name)?.close();
    this.coming.set(name, tree);
    await tree.open();
    if (this.coming.get(name) !== tree) return;
    this.redraw();
  }

  #take(name) {
    const tree = this.coming.get(name);
    if (!tree || (!tree.loaded.size && this.trees.has(name))) return;
    this.trees.get(name)?.close();
    this.trees.set(name, tree);
    this.coming.delete(name);
  }

  remove(name) {
    for (const held of [this.trees, this.coming]) {
      held.get(name)?.close();
      held.delete(name);
    }
    this.redraw();
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.orbit.apply();
    this.redraw();
  }

  redraw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.draw();
    });
  }

  draw() {
    const started = performance.now();
    const height = this.canvas.height;
    const trees = [...this.trees.values(), ...this.coming.values()];
    for (const tree of trees) {
      tree.limitPx = this.detailPx;
      tree.budget = this.budget;
      tree.choose(this.camera, height, FOV * RAD);
    }
    this.material.uniforms.pxPerM.value = height / (2 * Math.tan((FOV * RAD) / 2));
    this.renderer.setClearColor(new Color(getComputedStyle(document.body).getPropertyValue("--map").trim()));
    this.renderer.render(this.scene, this.camera);
    this.frames.push(performance.now() - started);
    if (this.frames.length > 120) this.frames.shift();
    this.drawn();
  }

  // Milliseconds of `count` frames of a turning view, each waited for until its pixels are there.
  async measure(count) {
    const gl = this.renderer.getContext();
    const found = [];
    for (let frame = 0; frame < count; frame++) {
      this.orbit.bearing += 360 / count;
      this.orbit.apply();
      const started = performance.now();
      this.draw();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      found.push(performance.now() - started);
      await new Promise((resolve) => setTimeout(resolve));
    }
    return found;
  }

  colour(mode, range) {
    setMode(this.material, mode, range);
    this.redraw();
  }

  show(id, on) {
    showClass(this.material, id, on);
    this.redraw();
  }

  size(px) {
    this.material.uniforms.pointPx.value = px;
    this.redraw();
  }

  // The line of a drive's way, places in the local frame; null: none.
  line(places) {
    if (this.way) {
      this.scene.remove(this.way);
      this.way.geometry.dispose();
    }
    this.way = null;
    if (places?.length > 1) {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(places.flatMap(({ x, y, z }) => [x, y, z])), 3));
      this.way = new Line(geometry, new LineBasicMaterial({ color: 0xe0662a }));
      this.way.frustumCulled = false;
      this.scene.add(this.way);
    }
    this.redraw();
  }

  tiles() {
    return [...this.trees.values()].flatMap((tree) => [...tree.shown]);
  }

  get points() {
    return [...this.trees.values()].reduce((sum, tree) => sum + tree.drawn, 0);
  }

  get isSettled() {
    return this.trees.size > 0 && this.coming.size === 0 && [...this.trees.values()].every((tree) => tree.isSettled) && !this.asked;
  }

  // Ids of the classes of which points are here.
  classesHere() {
    return new Set([...this.trees.values()].flatMap((tree) => [...tree.loaded].flatMap(({ classes }) => [...classes])));
  }

  // Lowest and highest value of what is drawn, without the outermost two in a hundred.
  rangeOf(mode) {
    if (mode === "confidence") return [0, 1];
    const values = [];
    for (const { points } of this.tiles()) {
      const [place, facts, seen] = ["position", "facts", "lastSeen"].map((name) => points.geometry.getAttribute(name).array);
      const row2 = [2, 6, 10, 14].map((at) => points.matrix.elements[at]);
      const step = Math.max(1, Math.floor(seen.length / 2000));
      for (let row = 0; row < seen.length; row += step) {
        if (mode === "drives") values.push(Math.log2(Math.max(facts[4 * row + 1], 1)));
        else if (mode === "age") values.push(seen[row]);
        else values.push(row2[0] * place[3 * row] + row2[1] * place[3 * row + 1] + row2[2] * place[3 * row + 2] + row2[3]);
      }
    }
    values.sort((a, b) => a - b);
    const at = (share) => values[Math.round(share * (values.length - 1))] ?? 0;
    if (mode === "drives") return [0, Math.max(at(1), 1)];
    const [low, high] = mode === "age" ? [at(0), at(1)] : [at(0.02), at(0.98)];
    return high > low ? [low, high] : [low - 1, high];
  }

  // The height of the ground at a place, by the smallest tile around it that is here; null where none is.
  groundAt(x, y) {
    const around = this.tiles().filter(({ sphere }) => Math.hypot(sphere.center.x - x, sphere.center.y - y) <= sphere.radius);
    return around.sort((a, b) => a.sphere.radius - b.sphere.radius)[0]?.low ?? null;
  }

  // The point nearest to the eye within a few pixels: { place, label, drives, confidence, lastSeen }, or null.
  pick(clientX, clientY, withinPx = 6) {
    const box = this.canvas.getBoundingClientRect();
    const [atX, atY] = [((clientX - box.left) / box.width) * 2 - 1, 1 - ((clientY - box.top) / box.height) * 2];
    const [nearX, nearY] = [(2 * withinPx) / box.width, (2 * withinPx) / box.height];
    const shown = this.material.uniforms.classes.value;
    const view = new Matrix4().multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
    let best = null;
    for (const { points } of this.tiles()) {
      const m = new Matrix4().multiplyMatrices(view, points.matrix).elements;
      const { array: place } = points.geometry.getAttribute("position");
      const { array: facts } = points.geometry.getAttribute("facts");
      for (let row = 0, at = 0; at < place.length; row++, at += 3) {
        const [x, y, z] = [place[at], place[at + 1], place[at + 2]];
        const w = m[3] * x + m[7] * y + m[11] * z + m[15];
        if (w <= 0 || (best && w >= best.w) || shown[facts[4 * row]].w === 0) continue;
        if (Math.abs((m[0] * x + m[4] * y + m[8] * z + m[12]) / w - atX) > nearX) continue;
        if (Math.abs((m[1] * x + m[5] * y + m[9] * z + m[13]) / w - atY) > nearY) continue;
        best = { w, points, row };
      }
    }
    if (!best) return null;
    const { geometry, matrix } = best.points;
    const facts = geometry.getAttribute("facts").array.subarray(4 * best.row, 4 * best.row + 3);
    const place = new Vector3().fromArray(geometry.getAttribute("position").array, 3 * best.row).applyMatrix4(matrix);
    return { place, label: facts[0], drives: facts[1], confidence: facts[2] / 255, lastSeen: geometry.getAttribute("lastSeen").array[best.row] };
  }

  // A PNG of what is seen, in the canvas's pixels.
  picture() {
    this.draw();
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
  }
}
