// An orbit around a place: pan, turn and zoom by mouse, touch and keyboard. Metres east, north, up; angles in degrees.

import { Vector3 } from "/static/vendor/three/three.bundle.mjs";

const RAD = Math.PI / 180;
const [NEAREST_M, FARTHEST_M] = [0.5, 60_000];
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export class Orbit {
  // changed(by): by "hand" or "program".
  constructor(camera, canvas, changed) {
    Object.assign(this, { camera, canvas, changed });
    this.target = new Vector3();
    this.distance = 120;
    this.bearing = 0;
    this.tilt = 40;
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  // tilt: 0 level, 90 straight down. bearing: of the view, clockwise from north.
  place(view, by = "program") {
    if (view.target) this.target.copy(view.target);
    this.distance = clamp(view.distance ?? this.distance, NEAREST_M, FARTHEST_M);
    this.bearing = (((view.bearing ?? this.bearing) % 360) + 360) % 360;
    this.tilt = clamp(view.tilt ?? this.tilt, 2, 89.9);
    this.apply();
    this.changed(by);
  }

  apply() {
    const { camera, target, distance } = this;
    const [turn, tilt] = [this.bearing * RAD, this.tilt * RAD];
    const back = new Vector3(-Math.sin(turn) * Math.cos(tilt), -Math.cos(turn) * Math.cos(tilt), Math.sin(tilt));
    camera.up.set(Math.sin(turn) * Math.sin(tilt), Math.cos(turn) * Math.sin(tilt), Math.cos(tilt));
    camera.position.copy(target).addScaledVector(back, distance);
    camera.lookAt(target);
    camera.near = Math.max(distance / 200, 0.1);
    camera.far = Math.max(distance * 40, 3000);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  // Pixels of the pointer; the ground under it goes along.
  pan(right, down) {
    const metres = (2 * this.distance * Math.tan((this.camera.fov * RAD) / 2)) / this.canvas.clientHeight;
    const turn = this.bearing * RAD;
    const forward = (down * metres) / Math.max(Math.sin(this.tilt * RAD), 0.25);
    const target = this.target.clone();
    target.x += -right * metres * Math.cos(turn) + forward * Math.sin(turn);
    target.y += right * metres * Math.sin(turn) + forward * Math.cos(turn);
    this.place({ target }, "hand");
  }

  turn(right, down) {
    this.place({ bearing: this.bearing + 0.3 * right, tilt: this.tilt + 0.3 * down }, "hand");
  }

  zoom(factor) {
    this.place({ distance: this.distance * factor }, "hand");
  }

  #down(event) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  #move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [right, down] = [now[0] - before[0], now[1] - before[1]];
    if (this.pointers.size === 2) return this.#pinch(event.pointerId, before, now);
    this.pointers.set(event.pointerId, now);
    if (this.pointers.size > 2) return;
    if (event.buttons === 2 || event.ctrlKey || event.shiftKey) this.turn(right, down);
    else this.pan(right, down);
  }

  // Two fingers: apart zooms, around each other turns, both up or down tilts.
  #pinch(id, before, now) {
    const other = [...this.pointers].find(([key]) => key !== id)[1];
    this.pointers.set(id, now);
    const between = ([x, y]) => [x - other[0], y - other[1]];
    const [was, is] = [between(before), between(now)];
    const bearing = this.bearing + (Math.atan2(was[1], was[0]) - Math.atan2(is[1], is[0])) / RAD;
    const distance = this.distance * clamp(Math.hypot(...was) / Math.max(Math.hypot(...is), 1), 0.5, 2);
    this.place({ bearing, distance, tilt: this.tilt + 0.1 * (now[1] - before[1]) }, "hand");
  }

  #wheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(clamp(event.deltaY, -200, 200) * 0.0015));
  }

  #key(event) {
    if (event.altKey || event.metaKey || event.ctrlKey) return;
    const arrow = KEYS[event.key];
    if (arrow && event.shiftKey) this.turn(20 * arrow[0], 15 * arrow[1]);
    else if (arrow) this.pan(-60 * arrow[0], 60 * arrow[1]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.8);
    else if (event.key === "-") this.zoom(1.25);
    else if (event.key === "n") this.place({ bearing: 0 }, "hand");
    else return;
    event.preventDefault();
  }
}
