// What an operator may do with a drive: the same on its card and on its page. Whoever may not operate gets none.

import { ask } from "/static/api.js";
import { dialog } from "/static/ui/dialogs.js";
import { OVER } from "/static/ui/words.js";

const IN_WORK = ["queued", "running"];

// Lines `key = value` of a table of settings as an object; values are JSON where they can be, else text.
export function tableOf(text) {
  const found = {};
  for (const line of text.split("\n").map((one) => one.trim()).filter(Boolean)) {
    const cut = line.indexOf("=");
    if (cut < 1) throw new Error(`${JSON.stringify(line)} is not of the form key = value`);
    const value = line.slice(cut + 1).trim();
    try {
      found[line.slice(0, cut).trim()] = JSON.parse(value);
    } catch {
      found[line.slice(0, cut).trim()] = value;
    }
  }
  return found;
}

// Deletes a drive. Returns it as it is now, about to go.
export const deleteDrive = (drive) => ask(`/v1/drives/${drive.id}`, { method: "DELETE" });

const post = (drive, what, body) => ask(`/v1/drives/${drive.id}/${what}`, { method: "POST", ...(body ? { body: JSON.stringify(body) } : {}) });

function stageDialog(drive) {
  const names = drive.stages.filter(({ stage }) => !["stitch", "publish"].includes(stage)).map(({ stage }) => [stage, stage]);
  const failed = drive.stages.find(({ state }) => state === "failed")?.stage;
  return dialog({
    title: `Try ${drive.name} again from a stage`, action: "Try again",
    text: "This stage and those after it are made anew, from what the stages before it have left.",
    fields: [{ name: "stage", label: "From", kind: "select", options: names, value: failed ?? names[0]?.[0] }],
    work: (wanted) => post(drive, "retry", wanted),
  });
}

function reprocessDialog(drive, { models }) {
  return dialog({
    title: `Process ${drive.name} anew`, action: "Process anew",
    text: "The map keeps the result before until the new one is published. Stages on which nothing has changed are not run again.",
    fields: [
      { name: "model", label: "Network", kind: "select", options: [["", "as the service is set"], ...models.map((one) => [one, one])] },
      { name: "rig", label: "Version of its rig's file", kind: "number", hint: "empty: the newest" },
      { name: "odometry", label: "Settings of [odometry]", kind: "long", hint: "one a line, as keyframe_distance_m = 1.5" },
      { name: "labelling", label: "Settings of [labelling]", kind: "long" },
    ],
    work: ({ model, rig, odometry, labelling }) =>
      post(drive, "reprocess", {
        ...(model ? { model } : {}), ...(rig ? { rig_version: Number(rig) } : {}), odometry: tableOf(odometry), labelling: tableOf(labelling),
      }),
  });
}

function releaseDialog(drive, { caller }) {
  const name = caller.name === "this machine" ? "" : caller.name.replace(/^user /, "");
  return dialog({
    title: `Release ${drive.name}`, action: "Release", text: "The drive is merged into the map in spite of its grade. Your name and reason stay with it.",
    fields: [{ name: "by", label: "Your name", value: name, required: true }, { name: "why", label: "Why", required: true }],
    check: ({ by, why }) => (by.trim() && why.trim() ? "" : "missing"),
    work: (wanted) => post(drive, "release", wanted),
  });
}

function deleteDialog(drive, { remove = deleteDrive }) {
  return dialog({
    title: `Delete ${drive.name}`, action: "Delete for good", danger: true,
    text: "Its files go at once, its part of the map with the next version. This cannot be undone.",
    fields: [{ name: "name", label: `Type the drive's name, ${drive.name}, to confirm` }],
    check: ({ name }) => (name === drive.name ? "" : "another name"),
    work: () => remove(drive),
  });
}

const isFailed = (drive) => drive.state === "failed" || drive.reprocess?.state === "failed";
const isAnew = ({ reprocess }) => ["running", "publishing"].includes(reprocess?.state);
const isRunning = (drive) => IN_WORK.includes(drive.state) || drive.reprocess?.state === "running";

// The actions that a drive has now, in their order: { id, label, danger, run() }. about: { caller, models, remove(drive) }; remove, if
// given, in place of deleteDrive.
export function actionsFor(drive, about) {
  if (!about.caller.rights.includes("operate") || drive.state === "removing") return [];
  const kept = drive.images.state === "kept";
  const { quality } = drive;
  const possible = [
    ["retry", "Try again", isFailed(drive) && kept, () => post(drive, "retry")],
    ["retry-from", "Try again from…", isFailed(drive) && kept, () => stageDialog(drive)],
    ["cancel", "Cancel", isRunning(drive), () => post(drive, "cancel")],
    ["release", "Release…", quality && !quality.release && quality.gate !== "merge" && drive.placed !== false, () => releaseDialog(drive, about)],
    ["revoke", "Take the release back", Boolean(quality?.release), () => ask(`/v1/drives/${drive.id}/release`, { method: "DELETE" })],
    ["reprocess", "Process anew…", OVER.includes(drive.state) && !isAnew(drive) && kept, () => reprocessDialog(drive, about)],
    ["delete", "Delete…", true, () => deleteDialog(drive, about)],
  ];
  return possible.filter(([, , may]) => may).map(([id, label, , run]) => ({ id, label, danger: id === "delete", run }));
}
