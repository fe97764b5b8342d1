// Who looks at this page: asked of the server, which sends those whom it does not know to the sign-in.

import { ask, headers, keepKey } from "/static/api.js";

// The caller, or never where the server wants a sign-in: the page goes there.
export const whoever = () => ask("/v1/session");

// Shows who has signed in, and a button that ends it; nothing on a server that asks nobody.
export function showCaller({ name }, into) {
  if (name === "this machine") return;
  const who = document.createElement("span");
  who.className = "quiet";
  who.id = "who";
  who.textContent = name.replace(/^user /, "");
  const button = document.createElement("button");
  button.type = "button";
  button.id = "sign-out";
  button.textContent = "Sign out";
  button.addEventListener("click", async () => {
    await fetch("/v1/session", { method: "DELETE", headers: headers() }).catch(() => null);
    keepKey(null);
    location.replace("/sign-in");
  });
  into.append(who, button);
}
