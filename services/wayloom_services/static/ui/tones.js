// Classes' colours on the map's ground: each stands off it by 3 : 1 (WCAG 2) and can be told from its neighbours (decision 116).

const dark = matchMedia("(prefers-color-scheme: dark)");
export const whenSchemeChanges = (work) => dark.addEventListener("change", work);
export const scheme = () => (dark.matches ? "dark" : "light");

const CONTRAST = 3.05; // what bytes round off does not lead below 3
const HALVINGS = 20;
const known = new Map();

const linear = (value) => (value <= 10.3 ? value / 3294.6 : ((value / 255 + 0.055) / 1.055) ** 2.4);
const byte = (value) => Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055));
export const bytesOf = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
const hexOf = (rgb) => `#${rgb.map((value) => byte(value).toString(16).padStart(2, "0")).join("")}`;
const luminance = ([red, green, blue]) => 0.2126 * red + 0.7152 * green + 0.0722 * blue;

// Linear sRGB to OKLab and back (Ottosson 2020).
const MIXED = [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566], [0.0883024619, 0.2817188376, 0.6299787005]];
const LAB = [[0.2104542553, 0.793617785, -0.0040720468], [1.9779984951, -2.428592205, 0.4505937099], [0.0259040371, 0.7827717662, -0.808675766]];
const UNLAB = [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.291485548]];
const UNMIXED = [[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965], [-0.0041960863, -0.7034186147, 1.707614701]];
const times = (matrix, [x, y, z]) => matrix.map(([a, b, c]) => a * x + b * y + c * z);
const labOf = (rgb) => times(LAB, times(MIXED, rgb).map(Math.cbrt));
const ofLab = (lab) => times(UNMIXED, times(UNLAB, lab).map((value) => value ** 3));

// The greatest share for which `holds`, which holds up to some share.
function greatest(holds) {
  let [low, high] = [0, 1];
  for (let step = 0; step < HALVINGS; step++) {
    const middle = (low + high) / 2;
    if (holds(middle)) low = middle;
    else high = middle;
  }
  return low;
}

// Of a lightness, with the hue and, as far as sRGB has such a colour, the chroma of another: white mixed in would leave cars the colour of walls.
function lit(lightness, [, a, b]) {
  const isColour = (share) => ofLab([lightness, share * a, share * b]).every((value) => value >= 0 && value <= 1);
  const share = greatest(isColour);
  return ofLab([lightness, share * a, share * b]);
}

function lighter(rgb, wanted) {
  const lab = labOf(rgb);
  return lit(greatest((lightness) => luminance(lit(lightness, lab)) < wanted), lab);
}

// All of them, white to just `most`: those that are too light alone would become as light as vegetation, and hardly another green.
function darker(rgb, most) {
  const share = 1 / (1 + luminance(rgb) * (1 / most - 1));
  return rgb.map((value) => value * share);
}

function toned(colour, on) {
  const rgb = bytesOf(colour).map(linear);
  const ground = luminance(bytesOf(getComputedStyle(document.documentElement).getPropertyValue(`--map-${on}`).trim()).map(linear)) + 0.05;
  if (on === "light") return hexOf(darker(rgb, ground / CONTRAST - 0.05));
  const least = CONTRAST * ground - 0.05;
  return luminance(rgb) < least ? hexOf(lighter(rgb, least)) : colour;
}

// colour: #rrggbb of a class. on: the scheme, light or dark.
export function tone(colour, on = scheme()) {
  const key = `${on} ${colour}`;
  if (!known.has(key)) known.set(key, toned(colour, on));
  return known.get(key);
}

// As a CSS colour, which follows the scheme by itself.
export const onGround = (colour) => `light-dark(${tone(colour, "light")}, ${tone(colour, "dark")})`;
