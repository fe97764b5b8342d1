// Numbers and states in the words of the pages.

export const STATES = {
  uploading: "arriving", queued: "waiting", running: "working", stitching: "joining the map", done: "in the map", held: "held",
  quarantined: "quarantined", failed: "failed", removing: "being removed",
};

export const OVER = ["done", "held", "quarantined", "failed"];

// The larger unit and what is left of the smaller: "1 min 31 s", "2 h 5 min", "3 min".
const inTwo = (number, base, large, small) => `${Math.floor(number / base)} ${large}${number % base ? ` ${number % base} ${small}` : ""}`;

export function duration(seconds) {
  const whole = Math.max(1, Math.round(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 600) return inTwo(whole, 60, "min", "s");
  const minutes = Math.round(seconds / 60);
  return minutes < 60 ? `${minutes} min` : inTwo(minutes, 60, "h", "min");
}

// An interval in one unit: "4 to 9 min".
export const between = (low, high) => {
  const [unit, name] = high < 90 ? [1, "s"] : high < 5400 ? [60, "min"] : [3600, "h"];
  const [from, to] = [low, high].map((one) => (unit === 3600 ? (one / unit).toFixed(1) : String(Math.max(1, Math.round(one / unit)))));
  return from === to ? `${to} ${name}` : `${from} to ${to} ${name}`;
};

export const size = (bytes) => {
  if (bytes < 1e6) return `${Math.ceil(bytes / 1e3)} kB`;
  return bytes < 1e9 ? `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB` : `${(bytes / 1e9).toFixed(2)} GB`;
};

export const many = (number, word) => `${number.toLocaleString("en")} ${word}${number === 1 ? "" : "s"}`;

export const metres = (values) => `${values.map((value) => value.toFixed(2)).join(", ")} m`;

export const moment = (seconds) => (seconds === null || seconds === undefined ? "–" : new Date(1000 * seconds).toLocaleString());

export const clock = (seconds) => new Date(1000 * seconds).toLocaleTimeString();

// What is left to do, in words: an interval, and whether it is a rough one.
export function etaWords({ eta }) {
  if (!eta) return "";
  return `${eta.rough ? "roughly " : ""}${between(eta.low_s, eta.high_s)} to go`;
}

// What a drive is doing, or did.
export function driveWords(drive) {
  if (drive.state === "uploading") return `${drive.received_files} of ${drive.files} files, ${size(drive.received_bytes)} of ${size(drive.bytes)}`;
  if (drive.reprocess?.state === "failed") return `processing anew failed, the result before stays: ${drive.reprocess.error}`;
  if (OVER.includes(drive.state) && !drive.reprocess && drive.note) return drive.note;
  const stage = drive.stages.find((one) => one.state === "running") ?? drive.stages.find((one) => one.state === "queued");
  if ((OVER.includes(drive.state) && !drive.reprocess) || !stage) {
    const took = drive.finished_at && drive.uploaded_at ? `, took ${duration(drive.finished_at - drive.uploaded_at)}` : "";
    return `${many(drive.files, "file")}, ${size(drive.bytes)}${took}`;
  }
  const parts = drive.reprocess ? ["processed anew", stage.stage] : [stage.stage];
  if (stage.state === "running") parts.push(`${Math.round(100 * stage.progress)} %`);
  if (stage.message) parts.push(stage.message);
  if (stage.attempt > 1) parts.push(`attempt ${stage.attempt}`);
  const left = etaWords(drive);
  if (left) parts.push(left);
  return parts.join(" · ");
}

// Whether the drive's result is doubted loudly: warnings stand for a drive that is over, or processed anew.
export const errorOf = (drive) => (drive.state === "failed" || drive.reprocess?.state === "failed" ? (drive.error ?? drive.reprocess?.error ?? "failed") : "");
