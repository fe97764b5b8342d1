// Classes' colours on the page's ground: in the dark they are lifted towards white, or buildings (#464646) would hardly stand off it.

const dark = matchMedia("(prefers-color-scheme: dark)");

// Share of white, which style.css states.
export const lift = () => parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--lift")) / 100;
export const whenSchemeChanges = (work) => dark.addEventListener("change", work);

// As a CSS colour, which follows the scheme by itself.
export const onGround = (colour) => `color-mix(in srgb, ${colour}, white var(--lift))`;
