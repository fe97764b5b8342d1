// How points are coloured: by class, height, drives, age or confidence, in one shader; hidden classes are not drawn.

import { Color, GLSL3, RawShaderMaterial, Vector3, Vector4 } from "/static/vendor/three/three.bundle.mjs";
import { tone } from "/static/ui/tones.js";
import { many } from "/static/ui/words.js";

export const MODES = ["class", "height", "drives", "age", "confidence"];
// Eight steps each, even in lightness: viridis for what grows, cividis for what gets old.
export const VIRIDIS = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"];
export const CIVIDIS = ["#fee838", "#dcc85a", "#bcae6c", "#9b9476", "#7c7b78", "#5c616e", "#3c4a6b", "#123570"];
const CLASSES = 20;

const VERTEX = `precision highp float;
precision highp int;
uniform mat4 modelMatrix, viewMatrix, projectionMatrix;
uniform int mode;
uniform vec4 classes[${CLASSES}];
uniform vec3 ramp[8];
uniform vec2 range;
uniform float pointPx, edgeM, pxPerM;
in vec3 position;
in vec4 facts;
in float lastSeen;
out vec3 tone;
vec3 along(float share) {
  float at = clamp(share, 0.0, 1.0) * 7.0;
  int low = min(int(at), 6);
  return mix(ramp[low], ramp[low + 1], at - float(low));
}
void main() {
  vec4 place = modelMatrix * vec4(position, 1.0);
  vec4 seen = viewMatrix * place;
  vec4 own = classes[int(facts.x + 0.5)];
  gl_Position = own.a > 0.0 ? projectionMatrix * seen : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = clamp(pointPx * edgeM * pxPerM / max(-seen.z, 0.1), pointPx, 4.0 * pointPx);
  float value = mode == 1 ? place.z : mode == 2 ? log2(max(facts.y, 1.0)) : mode == 3 ? lastSeen : facts.z / 255.0;
  tone = mode == 0 ? own.rgb : along((value - range.x) / max(range.y - range.x, 1e-6));
}`;
const FRAGMENT = `precision mediump float;
in vec3 tone;
out vec4 colour;
void main() {
  vec2 from = gl_PointCoord - 0.5;
  if (dot(from, from) > 0.26) discard;
  colour = vec4(tone, 1.0);
}`;

// Screen bytes as they are: the page's canvas and its colours are both sRGB.
const rgb = (css) => {
  const { r, g, b } = new Color().setStyle(css, "srgb-linear");
  return new Vector3(r, g, b);
};

export function pointMaterial(classes) {
  const own = Array.from({ length: CLASSES }, () => new Vector4(0.5, 0.5, 0.5, 1));
  const material = new RawShaderMaterial({
    glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT,
    uniforms: {
      mode: { value: 0 }, classes: { value: own }, ramp: { value: VIRIDIS.map(rgb) }, range: { value: [0, 1] },
      pointPx: { value: 2 }, edgeM: { value: 0.1 }, pxPerM: { value: 500 },
    },
  });
  setTones(material, classes);
  return material;
}

// Classes' colours on the ground of the page's scheme.
export function setTones(material, classes) {
  for (const { id, colour } of classes) {
    const own = material.uniforms.classes.value[id];
    own.set(...rgb(tone(colour)).toArray(), own.w);
  }
}

export function setMode(material, mode, range) {
  material.uniforms.mode.value = MODES.indexOf(mode);
  material.uniforms.ramp.value = (mode === "age" ? [...CIVIDIS].reverse() : VIRIDIS).map(rgb);
  material.uniforms.range.value = range;
}

export const showClass = (material, id, on) => material.uniforms.classes.value[id].setW(on ? 1 : 0);

// What the ends of a ramp mean, in words. baseM: height of the local frame's origin above the ellipsoid.
export function endsOf(mode, [low, high], baseM) {
  const day = (value) => new Date(value * 86_400_000).toISOString().slice(0, 10);
  if (mode === "height") return [`${(baseM + low).toFixed(0)} m`, `${(baseM + high).toFixed(0)} m above the ellipsoid`];
  if (mode === "drives") return [many(1, "drive"), many(Math.round(2 ** high), "drive")];
  return mode === "age" ? [day(low), day(high)] : ["0 %", "100 % of votes"];
}
