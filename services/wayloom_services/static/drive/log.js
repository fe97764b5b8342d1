// The log of a drive: its stages as they stand, and the history of every attempt with errors and evidence.

import { ask } from "/static/api.js";
import { at, element, table } from "/static/ui/dom.js";
import { clock, duration, moment } from "/static/ui/words.js";

const WORDS = {
  begun: "begun", done: "done", failed: "failed", again: "failed, is tried again", waits: "waits", lost: "worker lost", back: "given back by a worker that stops",
  cancelled: "cancelled", asked: "asked for again",
};

export function showStages({ stages }) {
  const rows = stages.map((stage) => {
    const state = element("span", `state ${stage.state}`, stage.state === "running" ? `${Math.round(100 * stage.progress)} %` : stage.state);
    const about = [stage.message, stage.error, ...stage.losses.map((one) => `worker lost at ${clock(one.at)}: ${one.why}`)].filter(Boolean).join("; ");
    return [stage.stage, state, stage.attempt ? String(stage.attempt) : "", moment(stage.started_at), stage.seconds === null ? "" : duration(stage.seconds), about];
  });
  at("stages").replaceChildren(table(rows, ["Stage", "State", "Attempt", "Begun", "Took", "Said"]));
}

export async function showHistory(id) {
  const { events, next } = await ask(`/v1/drives/${id}/history?limit=300`);
  const rows = events.map((one) => [
    moment(one.at), one.part ? `${one.stage}, part ${one.part}` : one.stage, one.attempt ? String(one.attempt) : "",
    element("span", `what ${one.what}`, WORDS[one.what] ?? one.what), [one.text, one.worker].filter(Boolean).join(" · "),
  ]);
  const more = next ? element("p", "quiet", "Older entries are not shown.") : "";
  at("history").replaceChildren(rows.length ? table(rows, ["When", "Stage", "Attempt", "What", "Said"]) : element("p", "quiet", "Nothing is written down of this drive."), more);
}
