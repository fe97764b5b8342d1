// A flight along a drive: the camera behind and above its way, at the pace that is asked for.

import { Vector3 } from "/static/vendor/three/three.bundle.mjs";

const AHEAD_M = 9;
const VIEW = { distance: 16, tilt: 14 };
const EYE_M = 1.6;

// Places (local frame) with metres along the way; steps under half a metre are left out.
export function wayOf(places) {
  const way = [];
  for (const place of places) {
    const last = way.at(-1);
    const step = last ? last.place.distanceTo(place) : 0;
    if (last && step < 0.5) continue;
    way.push({ place, at: last ? last.at + step : 0 });
  }
  return way;
}

// The place `metres` along a way.
export function placeAlong(way, metres) {
  const next = way.findIndex(({ at }) => at >= metres);
  if (next === 0) return way[0].place.clone();
  if (next < 0) return way.at(-1).place.clone();
  const [a, b] = [way[next - 1], way[next]];
  return a.place.clone().lerp(b.place, (metres - a.at) / (b.at - a.at));
}

export class Flight {
  // told(share, flying): how far, and whether it goes on.
  constructor(scene, told) {
    Object.assign(this, { scene, told, way: [], at: 0, speed: 8, flying: false, last: 0 });
  }

  take(way) {
    this.stop();
    this.way = way;
    this.at = 0;
  }

  get length() {
    return this.way.at(-1)?.at ?? 0;
  }

  goTo(share) {
    this.at = share * this.length;
    this.#look();
  }

  start() {
    if (this.flying || this.way.length < 2) return;
    if (this.at >= this.length) this.at = 0;
    Object.assign(this, { flying: true, last: performance.now() });
    requestAnimationFrame((now) => this.#step(now));
  }

  stop() {
    this.flying = false;
    this.told(this.length ? this.at / this.length : 0, false);
  }

  #step(now) {
    if (!this.flying) return;
    this.at = Math.min(this.at + this.speed * Math.min((now - this.last) / 1000, 0.5), this.length);
    this.last = now;
    this.#look();
    if (this.at >= this.length) return this.stop();
    requestAnimationFrame((then) => this.#step(then));
  }

  #look() {
    const here = placeAlong(this.way, this.at);
    const ahead = placeAlong(this.way, this.at + AHEAD_M);
    const way = new Vector3().subVectors(ahead, placeAlong(this.way, Math.max(this.at - 3, 0)));
    const bearing = way.length() > 0.1 ? (Math.atan2(way.x, way.y) * 180) / Math.PI : this.scene.orbit.bearing;
    // By the short way round, and not at once: ways by GNSS shake.
    const turn = ((bearing - this.scene.orbit.bearing + 540) % 360) - 180;
    this.scene.orbit.place({ target: here.setZ(here.z + EYE_M), bearing: this.scene.orbit.bearing + (this.flying ? 0.15 : 1) * turn, ...VIEW });
    this.told(this.length ? this.at / this.length : 0, this.flying);
  }
}
