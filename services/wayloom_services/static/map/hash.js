// The view in the page's address: readable words behind `#`, restored when the page is loaded and when the browser goes back.

export const readHash = () => new URLSearchParams(location.hash.slice(1));

// Writes what is not empty. step: whether the browser's back button shall come back to what was before.
export function writeHash(words, step = false) {
  const text = Object.entries(words)
    .filter(([, value]) => value !== null && value !== undefined && value !== "")
    .map(([name, value]) => `${name}=${String(value).split(",").map(encodeURIComponent).join(",")}`)
    .join("&");
  const address = `${location.pathname}${location.search}${text ? `#${text}` : ""}`;
  if (address === `${location.pathname}${location.search}${location.hash}`) return;
  if (step) history.pushState(null, "", address);
  else history.replaceState(history.state, "", address);
}

// Numbers of a word, or null where there are not so many.
export function numbersOf(text, count) {
  const found = (text ?? "").split(",").map(Number);
  return found.length === count && text && found.every(Number.isFinite) ? found : null;
}
