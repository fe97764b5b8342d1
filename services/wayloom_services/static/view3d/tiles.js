// Level of detail of the 3D tiles: a tree of tiles, refined where its screen-space error is largest until all is fine or a budget of points is spent.

import { Frustum, Matrix4, Points, Sphere, Vector3 } from "/static/vendor/three/three.bundle.mjs";
import { send } from "/static/api.js";
import { pointsOf } from "/static/view3d/glb.js";

const AT_ONCE = 6;
const AGAIN_MS = 10_000;
const USUAL_POINTS = 15_000;
const KEPT_OVER_BUDGET = 3;
// glTF's y is up, the map's is z.
const TURN = new Matrix4().set(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1);

class Tile {
  constructor(json, base, above) {
    const shift = new Matrix4();
    if (json.transform) shift.fromArray(json.transform);
    this.T = above.clone().multiply(shift);
    const [x, y, z, ...axes] = json.boundingVolume.box;
    this.sphere = new Sphere(new Vector3(x, y, z), Math.hypot(axes[0], axes[4], axes[8])).applyMatrix4(this.T);
    this.low = this.sphere.center.z - axes[8];
    this.high = this.sphere.center.z + axes[8];
    this.error = json.geometricError;
    this.address = json.content ? new URL(json.content.uri, base) : null;
    this.isLink = this.address?.pathname.endsWith(".json") ?? false;
    this.children = (json.children ?? []).map((child) => new Tile(child, base, this.T));
    Object.assign(this, { state: "new", points: null, count: USUAL_POINTS, used: 0, sse: Infinity });
  }
}

export class TileTree {
  // address: of a tileset.json. frame: a LocalFrame. into: the scene. changed(): something has come. failed(error): something has not.
  constructor(address, { frame, into, material, changed, failed }) {
    Object.assign(this, { address, frame, into, material, changed, failed });
    this.limitPx = 8;
    this.budget = 2_000_000;
    this.root = null;
    this.loaded = new Set();
    this.shown = new Set();
    this.wanted = [];
    this.loading = 0;
    this.turn = 0;
    this.gone = false;
  }

  async open() {
    const json = await this.#get(this.address, "json");
    // The root turns the map's frame to the Earth's; here all is drawn in the frame of the view.
    this.root = new Tile({ ...json.root, transform: null }, new URL(this.address, location.href), this.frame.T_local_map);
    return this;
  }

  async #get(address, kind) {
    const answer = await send(address);
    if (!answer.ok || answer.status === 204) throw new Error(`${answer.status} for ${new URL(address, location.href).pathname}`);
    return kind === "json" ? answer.json() : answer.arrayBuffer();
  }

  // Chooses what is drawn from here. heightPx and fov (rad) of the picture.
  choose(camera, heightPx, fov) {
    if (!this.root) return;
    this.turn++;
    this.wanted = [];
    this.eye = camera.position;
    this.pxPerM = heightPx / (2 * Math.tan(fov / 2));
    this.frustum = new Frustum().setFromProjectionMatrix(new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const chosen = this.#refined();
    const before = this.shown;
    this.shown = new Set(chosen.filter((tile) => tile.points));
    for (const tile of before) if (!this.shown.has(tile) && tile.points) tile.points.visible = false;
    for (const tile of this.shown) tile.points.visible = true;
    this.#load();
    this.#forget();
  }

  // The best cut of the tree that is here: largest errors are refined first. What is missing for a finer one is put on the list.
  #refined() {
    const queue = this.#parts(this.root);
    const done = [];
    let points = queue.reduce((sum, tile) => sum + tile.count, 0);
    while (queue.length) {
      queue.sort((a, b) => a.sse - b.sse);
      const tile = queue.pop();
      tile.used = this.turn;
      this.#want(tile);
      const finer = tile.sse > this.limitPx ? tile.children.flatMap((child) => this.#parts(child)) : [];
      const more = finer.reduce((sum, child) => sum + child.count, 0) - tile.count;
      if (!tile.children.length || tile.sse <= this.limitPx || points + more > this.budget) {
        done.push(tile);
        continue;
      }
      finer.forEach((child) => this.#want(child));
      if (finer.every((child) => child.points) && !this.#waits(tile)) {
        queue.push(...finer);
        points += more;
      } else {
        done.push(tile);
      }
    }
    return done;
  }

  // A tile as it takes part: itself where it has points, what its file says where it is a link, nothing out of sight.
  #parts(tile) {
    if (!this.frustum.intersectsSphere(tile.sphere)) return [];
    const distance = Math.max(this.eye.distanceTo(tile.sphere.center) - tile.sphere.radius, 0.5);
    tile.sse = (tile.error * this.pxPerM) / distance;
    if (tile.isLink || !tile.address) {
      tile.used = this.turn;
      if (tile.isLink && tile.state !== "here") this.#want(tile);
      return tile.children.flatMap((child) => this.#parts(child));
    }
    return [tile];
  }

  // Whether a link below, in sight, has not come: its tiles would leave a hole.
  #waits(tile) {
    return tile.children.some((child) => child.isLink && child.state !== "here" && this.frustum.intersectsSphere(child.sphere));
  }

  #want(tile) {
    if (tile.address && tile.state === "new") this.wanted.push(tile);
  }

  #load() {
    this.wanted.sort((a, b) => Number(b.isLink) - Number(a.isLink) || b.sse - a.sse);
    for (const tile of this.wanted) {
      if (this.loading >= AT_ONCE) return;
      if (tile.state !== "new") continue;
      tile.state = "coming";
      this.loading++;
      this.#fetch(tile)
        .then(() => (tile.state = "here"), (error) => this.#fail(tile, error))
        .finally(() => (this.loading--, this.gone || this.changed()));
    }
  }

  // It is tried again after a while: the link may be back.
  #fail(tile, error) {
    tile.state = "failed";
    if (this.gone) return;
    this.failed(error);
    setTimeout(() => {
      if (this.gone || tile.state !== "failed") return;
      tile.state = "new";
      this.changed();
    }, AGAIN_MS);
  }

  async #fetch(tile) {
    if (tile.isLink) {
      const { root } = await this.#get(tile.address, "json");
      tile.children = [new Tile(root, tile.address, tile.T)];
      return;
    }
    const found = pointsOf(await this.#get(tile.address, "bytes"));
    if (this.gone) return found.geometry.dispose();
    tile.points = new Points(found.geometry, this.material);
    tile.points.matrixAutoUpdate = false;
    tile.points.matrix.copy(tile.T).multiply(TURN);
    tile.points.matrixWorldNeedsUpdate = true;
    tile.points.visible = false;
    tile.points.onBeforeRender = () => {
      this.material.uniforms.edgeM.value = found.edgeM;
      this.material.uniformsNeedUpdate = true;
    };
    tile.count = found.count;
    tile.classes = found.classes;
    this.loaded.add(tile);
    this.into.add(tile.points);
  }

  // Least recently used first, when far more is held than may be drawn.
  #forget() {
    let held = [...this.loaded].reduce((sum, tile) => sum + tile.count, 0);
    if (held <= KEPT_OVER_BUDGET * this.budget) return;
    for (const tile of [...this.loaded].sort((a, b) => a.used - b.used)) {
      if (held <= 2 * this.budget || tile.used >= this.turn - 1) return;
      held -= tile.count;
      this.#drop(tile);
    }
  }

  #drop(tile) {
    this.into.remove(tile.points);
    tile.points.geometry.dispose();
    Object.assign(tile, { points: null, state: "new" });
    this.loaded.delete(tile);
    this.shown.delete(tile);
  }

  close() {
    this.gone = true;
    for (const tile of [...this.loaded]) this.#drop(tile);
  }

  get isSettled() {
    return this.root !== null && this.loading === 0 && !this.wanted.some((tile) => tile.state === "new");
  }

  get drawn() {
    return [...this.shown].reduce((sum, tile) => sum + tile.count, 0);
  }
}
