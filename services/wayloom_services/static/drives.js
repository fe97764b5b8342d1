// The list of drives: one card each, changed in place as its drive goes on.

const WORDS = { uploading: "arriving", queued: "waiting", running: "working", stitching: "joining the map", done: "in the map", held: "held", quarantined: "quarantined", failed: "failed", removing: "being removed" };

const OVER = ["done", "held", "quarantined", "failed"];

export const element = (tag, className, text) => {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
};

const duration = (seconds) => {
  if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
};

const size = (bytes) => (bytes < 1e6 ? `${Math.ceil(bytes / 1e3)} kB` : bytes < 1e9 ? `${(bytes / 1e6).toFixed(0)} MB` : `${(bytes / 1e9).toFixed(2)} GB`);

function words(drive) {
  if (drive.state === "uploading") return `${drive.received_files} of ${drive.files} files, ${size(drive.received_bytes)} of ${size(drive.bytes)}`;
  if (drive.reprocess?.state === "failed") return `processing anew failed, the result before stays: ${drive.reprocess.error}`;
  const stage = drive.stages.find((one) => one.state === "running") ?? drive.stages.find((one) => one.state === "queued");
  if ((OVER.includes(drive.state) && !drive.reprocess) || !stage) {
    const took = drive.finished_at && drive.uploaded_at ? `, took ${duration(drive.finished_at - drive.uploaded_at)}` : "";
    return `${drive.files} files, ${size(drive.bytes)}${took}`;
  }
  const parts = drive.reprocess ? ["processed anew", stage.stage] : [stage.stage];
  if (stage.state === "running") parts.push(`${Math.round(100 * stage.progress)} %`);
  if (stage.message) parts.push(stage.message);
  if (stage.attempt > 1) parts.push(`attempt ${stage.attempt}`);
  if (drive.eta_s !== null) parts.push(`about ${duration(drive.eta_s)} to go`);
  return parts.join(" · ");
}

function stageBar(stage) {
  const bar = element("span", stage.state);
  const took = stage.seconds === null ? "" : `, ${duration(stage.seconds)}`;
  bar.title = `${stage.stage}: ${stage.state}${took}${stage.error ? `\n${stage.error}` : ""}`;
  const fill = element("b");
  fill.style.width = `${100 * stage.progress}%`;
  bar.append(fill);
  return bar;
}

// A drive's grade as a badge; nothing before it is judged.
export function gradeBadge(quality) {
  if (!quality) return "";
  const badge = element("span", `grade ${quality.gate}`, quality.grade ?? "–");
  badge.title = quality.grade ? `grade ${quality.grade}` : "no place on Earth";
  return badge;
}

function report(drive) {
  const link = element("a", "report", "Quality report");
  link.href = `/drives/${drive.id}`;
  link.addEventListener("click", (event) => event.stopPropagation());
  return link;
}

// The content of a drive's card. retry() is called when the drive shall be tried again; null for those who may not.
export function fillCard(card, drive, retry) {
  const top = element("div", "top");
  const name = element("span", "name", drive.name);
  name.title = drive.id;
  top.append(name, gradeBadge(drive.quality), element("span", `state ${drive.state}`, WORDS[drive.state]));
  const stages = element("div", "stages");
  stages.append(...drive.stages.map(stageBar));
  const told = OVER.includes(drive.state) && !drive.reprocess && drive.note;
  card.replaceChildren(top, stages, element("div", "words", told ? drive.note : words(drive)));
  card.dataset.id = drive.id;
  card.dataset.state = drive.state;
  if (drive.quality) card.append(report(drive));
  if (drive.state === "failed" || drive.reprocess?.state === "failed") {
    card.append(element("div", "error", drive.error ?? drive.reprocess?.error ?? "failed"));
    if (!retry) return;
    const button = element("button", "", "Try again");
    button.type = "button";
    button.addEventListener("click", (event) => {
      event.stopPropagation();
      button.disabled = true;
      retry();
    });
    card.append(button);
  }
}
