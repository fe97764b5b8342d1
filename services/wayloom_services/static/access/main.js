// Access, for admins: keys, made, given a new secret and revoked; and the audit log.

import { ask } from "/static/api.js";
import { dialog } from "/static/ui/dialogs.js";
import { at, button, element, say, table } from "/static/ui/dom.js";
import { follow, frame, telling } from "/static/ui/frame.js";
import { moment } from "/static/ui/words.js";

const DAY_S = 86400;
const ROLES = ["vehicle", "viewer", "operator", "admin"];
const caller = await frame();
let entries = [];
let next = null;
let asked = 0;

const stateOf = ({ revoked_at: revoked, expires_at: expires }) => {
  if (revoked) return `revoked ${moment(revoked)}`;
  if (!expires) return "valid";
  return expires * 1000 < Date.now() ? `expired ${moment(expires)}` : `valid until ${moment(expires)}`;
};

// Ids of drives are too long for a table: their beginning, and all of it in its title.
function brief(object) {
  const cell = element("code", "", object.length > 20 ? `${object.slice(0, 12)}…` : object);
  cell.title = object;
  return cell;
}

async function showKeys() {
  const { keys } = await ask("/v1/keys");
  if (!keys.length) return at("keys").replaceChildren(element("p", "quiet", "There is no key yet."));
  const rows = keys.map((key) => {
    const acts = element("div", "row");
    if (!key.revoked_at) acts.append(button("New secret…", "", () => telling("keys", () => rotate(key))), button("Revoke…", "danger", () => telling("keys", () => revoke(key))));
    return [key.name, element("code", "", key.prefix), key.role, key.vehicle_id ?? "", stateOf(key), moment(key.used_at), acts];
  });
  at("keys").replaceChildren(table(rows, ["What for", "Key", "Role", "Vehicle", "State", "Last used", "Actions"]));
}

// A key's text is shown this once.
async function tellKey(made) {
  if (!made) return;
  at("made").hidden = false;
  at("made").replaceChildren(element("p", "", `The key ${made.name}. It is shown this once: copy it now.`), element("code", "", made.key));
  await showKeys();
}

async function create() {
  let made = null;
  await dialog({
    title: "New key", action: "Make it",
    fields: [
      { name: "name", label: "What for", required: true },
      { name: "role", label: "Role", kind: "select", options: ROLES.map((one) => [one, one]), value: "vehicle" },
      { name: "vehicle", label: "Vehicle", hint: "of a vehicle's key: the one whose drives alone it sends" },
      { name: "days", label: "Valid for days", kind: "number", hint: "empty: for good" },
    ],
    check: ({ name }) => (name.trim() ? "" : "no name"),
    work: async ({ name, role, vehicle, days }) => {
      const wanted = { name: name.trim(), role, vehicle_id: vehicle.trim() || null, expires_in_s: days ? DAY_S * Number(days) : null };
      made = await ask("/v1/keys", { method: "POST", body: JSON.stringify(wanted) });
    },
  });
  await tellKey(made);
}

async function rotate(key) {
  let made = null;
  await dialog({
    title: `A new secret for ${key.name}`, action: "Make it", text: "The one before is taken for a while, so that whoever has it can get the new one.",
    work: async () => (made = await ask(`/v1/keys/${key.prefix}/rotate`, { method: "POST" })),
  });
  await tellKey(made);
}

async function revoke(key) {
  const done = await dialog({
    title: `Revoke ${key.name}`, action: "Revoke", danger: true, text: "Whoever uses it is refused from now on.",
    work: () => ask(`/v1/keys/${key.prefix}`, { method: "DELETE" }),
  });
  if (done) await showKeys();
}

async function showAudit(before) {
  const mine = ++asked;
  const wanted = { limit: 100, ...(before ? { before } : {}), ...(at("actor").value.trim() ? { actor: at("actor").value.trim() } : {}), ...(at("outcome").value ? { outcome: at("outcome").value } : {}) };
  const page = await ask(`/v1/audit?${new URLSearchParams(wanted)}`);
  if (mine !== asked) return;
  entries = before ? [...entries, ...page.entries] : page.entries;
  next = page.next;
  at("older").hidden = next === null;
  if (!entries.length) return at("audit").replaceChildren(element("p", "quiet", "Nothing of that kind."));
  const rows = entries.map((one) => [
    moment(one.at), one.actor, one.action, brief(one.object), element("span", `what ${one.outcome}`, `${one.outcome} (${one.status})`), one.count > 1 ? `${one.count} times` : "", one.address,
  ]);
  at("audit").replaceChildren(table(rows, ["When", "Who", "What", "Of", "Outcome", "Times", "From"]));
}

async function showOlder() {
  at("older").disabled = true;
  try {
    await showAudit(next);
  } finally {
    at("older").disabled = false;
  }
}

if (!caller.rights.includes("manage")) say(at("problem"), "Keys and audit log are shown to admins alone.");
else {
  at("new-key").addEventListener("click", () => telling("keys", create));
  at("audit-filter").addEventListener("submit", (event) => {
    event.preventDefault();
    telling("audit", showAudit);
  });
  at("older").addEventListener("click", () => telling("audit", showOlder));
  for (const button of document.querySelectorAll("main button")) button.disabled = false;
  await Promise.all([telling("keys", showKeys), telling("audit", showAudit)]);
}
follow(() => {});
