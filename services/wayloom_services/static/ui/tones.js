// Classes' colours on the page's ground: in the dark they are lifted towards white, or buildings (#464646) would hardly stand off it. style.css
// has the same share.

const dark = matchMedia("(prefers-color-scheme: dark)");

// Share of white.
export const lift = () => (dark.matches ? 0.2 : 0);
export const whenSchemeChanges = (work) => dark.addEventListener("change", work);

// As a CSS colour, which follows the scheme by itself.
export const onGround = (colour) => `color-mix(in srgb, ${colour}, white var(--lift))`;
