// The sign-in page: a name and a password for a session's cookie, or a key for this tab; then back to the page that asked for it.

import { ask, keepKey, Refused } from "/static/api.js";

const at = (id) => document.getElementById(id);

// A page of this server, whatever the address says.
function goBack() {
  const wanted = new URL(new URLSearchParams(location.search).get("next") ?? "/", location.origin);
  location.replace(wanted.origin === location.origin ? wanted.pathname : "/");
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
    goBack();
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
