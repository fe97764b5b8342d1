// WGS84 and tangent planes: places on Earth to metres east, north, up of a frame, and back. Angles in degrees at the doors.

import { Matrix4, Vector3 } from "/static/vendor/three/three.bundle.mjs";

const A = 6378137.0;
const E2 = 0.0066943799901413165;
const RAD = Math.PI / 180;

export function ecefFrom(lon, lat, height) {
  const [sinLat, cosLat] = [Math.sin(lat * RAD), Math.cos(lat * RAD)];
  const n = A / Math.sqrt(1 - E2 * sinLat * sinLat);
  return new Vector3(
    (n + height) * cosLat * Math.cos(lon * RAD), (n + height) * cosLat * Math.sin(lon * RAD), (n * (1 - E2) + height) * sinLat,
  );
}

// [longitude, latitude, ellipsoidal height]; below a millimetre off after four steps anywhere near the ground.
export function lonLatHeightFrom({ x, y, z }) {
  const p = Math.hypot(x, y);
  let lat = Math.atan2(z, p * (1 - E2));
  let height = 0;
  for (let step = 0; step < 4; step++) {
    const n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
    height = p / Math.cos(lat) - n;
    lat = Math.atan2(z, p * (1 - (E2 * n) / (n + height)));
  }
  return [Math.atan2(y, x) / RAD, lat / RAD, height];
}

// T_ecef_enu of the tangent plane at a place.
export function ecefFromEnu([lon, lat, height]) {
  const [sinLon, cosLon, sinLat, cosLat] = [Math.sin(lon * RAD), Math.cos(lon * RAD), Math.sin(lat * RAD), Math.cos(lat * RAD)];
  const origin = ecefFrom(lon, lat, height);
  return new Matrix4().set(
    -sinLon, -sinLat * cosLon, cosLat * cosLon, origin.x,
    cosLon, -sinLat * sinLon, cosLat * sinLon, origin.y,
    0, cosLat, sinLat, origin.z,
    0, 0, 0, 1,
  );
}

// The local frame of a view: the tangent plane at `anchor`, in which up is up, however far the map's own origin is.
export class LocalFrame {
  constructor(anchor, mapFrame) {
    this.T_ecef_local = ecefFromEnu(anchor);
    this.T_local_ecef = this.T_ecef_local.clone().invert();
    this.T_local_map = this.T_local_ecef.clone().multiply(ecefFromEnu(mapFrame));
  }

  // Metres east, north, up.
  local(lon, lat, height) {
    return ecefFrom(lon, lat, height).applyMatrix4(this.T_local_ecef);
  }

  geographic(place) {
    return lonLatHeightFrom(place.clone().applyMatrix4(this.T_ecef_local));
  }
}
