// What every page has around it: who looks, which pages there are for them, and whether the service answers.

import { at, say } from "/static/ui/dom.js";
import { showCaller, whoever } from "/static/session.js";

// The caller; the links of pages that want a right which it has not are taken away.
export async function frame() {
  const caller = await whoever();
  for (const one of document.querySelectorAll("nav [data-right]")) one.hidden = !caller.rights.includes(one.dataset.right);
  showCaller(caller, document.querySelector("header"));
  return caller;
}

let heard = null;

// Shows by what the page hears of changes, and that the service does not answer, with the time of what is shown.
export function live(state) {
  const away = state === "offline" || state.startsWith("refused");
  at("live").textContent = state;
  at("live").className = `pill ${state === "live" ? "good" : away ? "bad" : ""}`;
  if (!away) heard = new Date();
  const since = heard ? ` Shown is what was known at ${heard.toLocaleTimeString()}.` : "";
  say(at("away"), away ? `The service does not answer.${since} This page asks again by itself.` : "");
}

// Tells people who do not see the page what has changed, one sentence at a time.
export function announce(text) {
  at("said").textContent = text;
}
