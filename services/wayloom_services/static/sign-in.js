// The sign-in page: a name and a password for a session's cookie, or a key for this tab; then back to the page that asked for it.

import { ask, keepKey, Refused } from "/static/api.js";

const at = (id) => document.getElementById(id);

// A page of this server with what it shows, whatever the address says.
function ownPath() {
  const next = new URLSearchParams(location.search).get("next") ?? "/";
  const wanted = URL.canParse(next, location.origin) ? new URL(next, location.origin) : new URL(location.origin);
  // `//host` is a path in an address, and another host where it stands alone.
  const isOwn = wanted.origin === location.origin && !wanted.pathname.startsWith("//") && wanted.pathname !== location.pathname;
  return isOwn ? wanted.pathname + wanted.search + wanted.hash : "/";
}

// The way to the OpenID provider, where the server has one.
async function offerProvider() {
  const { oidc_label: label } = await ask("/v1/info");
  if (!label) return;
  at("oidc-link").textContent = label;
  at("oidc-link").href = `/v1/session/oidc?next=${encodeURIComponent(ownPath())}`;
  at("oidc-link").addEventListener("click", () => keepKey(null));
  at("oidc").hidden = false;
}

function tell(error) {
  at("problem").hidden = false;
  at("problem").textContent = error instanceof Refused ? error.message : "The server does not answer.";
}

async function attempt(form, work) {
  const button = form.querySelector("button");
  button.disabled = true;
  try {
    await work();
    location.replace(ownPath());
  } catch (error) {
    tell(error);
    button.disabled = false;
  }
}

at("sign-in").addEventListener("submit", (event) => {
  event.preventDefault();
  keepKey(null);
  const body = JSON.stringify({ name: at("name").value, password: at("password").value });
  attempt(event.target, () => ask("/v1/session", { method: "POST", body }));
});

at("with-key").addEventListener("submit", (event) => {
  event.preventDefault();
  keepKey(at("key").value);
  attempt(event.target, () => ask("/v1/session"));
});

// Until now a form would have been sent by the browser itself: to nobody, and the page to return to would be forgotten.
for (const button of document.querySelectorAll("form button")) button.disabled = false;

offerProvider().catch(() => {}); // names and passwords work without it
