// The points of one 3D tile (docs/formats.md, "3D tiles"): places as they came, and what colours them in six bytes a point.

import { BufferAttribute, BufferGeometry, Sphere, Vector3 } from "/static/vendor/three/three.bundle.mjs";

const GLTF = 0x46546c67;
const HEAD = 20;
const CHUNK_HEAD = 8;

// Its document, and its body as a view. Throws an Error for bytes that are none.
export function openGlb(bytes) {
  const view = new DataView(bytes);
  if (bytes.byteLength < HEAD + CHUNK_HEAD || view.getUint32(0, true) !== GLTF) throw new Error("a tile is no glTF file");
  const size = view.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, HEAD, size)));
  return { document, body: new DataView(bytes, HEAD + size + CHUNK_HEAD) };
}

// geometry: position (m from the tile's origin, y up), facts (class, drives, confidence of 255), lastSeen (days since 1970).
// edgeM: of the cells that points stand for; voxelM where each is a voxel.
export function pointsOf(bytes, voxelM = 0.1) {
  const { document, body } = openGlb(bytes);
  const { attributes } = document.meshes[0].primitives[0];
  const accessor = (name) => document.accessors[attributes[name]] ?? null;
  const { count, min, max } = accessor("POSITION");
  const { byteStride: stride, byteOffset: start = 0 } = document.bufferViews[0];
  const at = (name) => start + (accessor(name)?.byteOffset ?? 0);
  const [place, label, drives, confidence, seen] = ["POSITION", "_FEATURE_ID_0", "_DRIVES", "_CONFIDENCE", "_LAST_SEEN"].map(at);
  // Tiles that were cut before the day was kept have none.
  const hasDay = accessor("_LAST_SEEN") !== null;
  const position = new Float32Array(3 * count);
  const facts = new Uint8Array(4 * count);
  const lastSeen = new Uint16Array(count);
  const classes = new Set();
  for (let row = 0, from = 0; row < count; row++, from += stride) {
    for (let axis = 0; axis < 3; axis++) position[3 * row + axis] = body.getFloat32(place + from + 4 * axis, true);
    classes.add((facts[4 * row] = body.getUint8(label + from)));
    facts[4 * row + 1] = body.getUint8(drives + from);
    facts[4 * row + 2] = body.getUint8(confidence + from);
    if (hasDay) lastSeen[row] = body.getUint16(seen + from, true);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(position, 3));
  geometry.setAttribute("facts", new BufferAttribute(facts, 4));
  geometry.setAttribute("lastSeen", new BufferAttribute(lastSeen, 1));
  const [low, high] = [new Vector3(...min), new Vector3(...max)];
  geometry.boundingSphere = new Sphere(low.clone().add(high).multiplyScalar(0.5), low.distanceTo(high) / 2);
  return { geometry, count, classes, edgeM: document.extras.edge / 256 || voxelM };
}
