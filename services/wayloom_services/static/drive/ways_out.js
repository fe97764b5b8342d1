// What can be done about a drive that is held or quarantined, and by whom.

import { actionsFor } from "/static/ui/actions.js";
import { element } from "/static/ui/dom.js";

const WORDS = {
  release: "Release it by the form below: it joins the map in spite of its grade.",
  reprocess: "Process it anew with other settings, by the button at the top.",
  delete: "Delete it, by the button at the top.",
};
const NO_PLACE = "It has no place on Earth, so it cannot be released: send it again with GNSS.";
const NO_IMAGES = "Its images are deleted: send the same log once more (wayloom upload LOG --again) to process it anew.";
const WAIT = "Wait: drives that come later and meet it may place it.";

const isOutside = ({ state, quality }) => ["held", "quarantined"].includes(state) && !quality.release && !quality.by_map?.admitted;

function forOperators(drive, about) {
  const possible = actionsFor(drive, about).map(({ id }) => WORDS[id]).filter(Boolean);
  if (drive.images.state !== "kept") possible.splice(-1, 0, NO_IMAGES);
  return drive.placed === false ? [NO_PLACE, ...possible] : possible;
}

function forOthers({ placed }) {
  const release = placed === false ? "" : "release it into the map, ";
  return [`An operator may ${release}process it anew with other settings or delete it. You may look at it.`];
}

// As entries of a list; none for a drive that is in the map or on its way. about: { caller, models }.
export function waysOut(drive, about) {
  if (!drive.quality || !isOutside(drive)) return [];
  const waits = drive.quality.gate === "hold" && drive.quality.sound && drive.placed !== false ? [WAIT] : [];
  const ways = about.caller.rights.includes("operate") ? forOperators(drive, about) : forOthers(drive);
  return [...waits, ...ways].map((text) => element("li", "", text));
}
