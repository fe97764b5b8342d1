// What every page has around it: who looks, which pages there are for them, and whether the service answers.

import { listen } from "/static/api.js";
import { at, say } from "/static/ui/dom.js";
import { showCaller, whoever } from "/static/session.js";

// The caller; the links of pages that want a right which it has not are taken away.
export async function frame() {
  const caller = await whoever();
  for (const one of document.querySelectorAll("nav [data-right]")) one.hidden = !caller.rights.includes(one.dataset.right);
  showCaller(caller, document.querySelector("header"));
  return caller;
}

const LIVE = { live: "live", polling: "asked for every few seconds", away: "not live, the service does not answer" };
let heard = null;

// Hears of changes as long as the page is open. again(): called when the stream is back after it was away, of which it tells nothing.
export function follow(hear, again = () => {}) {
  let before = null;
  listen(hear, (state) => {
    live(state);
    if (state === "live" && before !== null) again();
    before = state;
  });
}

// Shows by what the page hears of changes, on each block that lives by them too; and that the service does not answer, with the time of
// what is shown.
function live(state) {
  const away = state === "offline" || state.startsWith("refused");
  for (const block of document.querySelectorAll("[data-live]")) {
    block.dataset.live = away ? "away" : state;
    block.ariaLabel = block.title = `${block.dataset.of}: ${LIVE[block.dataset.live]}`;
  }
  at("live").textContent = state;
  at("live").className = `pill ${state === "live" ? "good" : away ? "bad" : ""}`;
  if (!away) heard = new Date();
  const since = heard ? ` Shown is what was known at ${heard.toLocaleTimeString()}.` : "";
  say(at("away"), away ? `The service does not answer.${since} This page asks again by itself.` : "");
}

const problems = new Map();

// Says what does not go well, until the same does: the list may come again while what was refused is still to be read.
export async function telling(what, work) {
  try {
    await work();
    problems.delete(what);
  } catch (error) {
    if (error.name === "AbortError") return; // given up by the page itself
    problems.set(what, error.message);
  }
  say(at("problem"), [...new Set(problems.values())].join(" "));
}

// Tells people who do not see the page what has changed, one sentence at a time.
export function announce(text) {
  at("said").textContent = text;
}
