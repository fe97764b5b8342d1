// The gate's verdict on a drive, in words.

const WORDS = { merge: "good enough for the map", hold: "held: it waits for drives that place it, or an operator", quarantine: "quarantined: not merged" };

// What the map does with the drive.
function outcome({ state, quality: { gate, release, by_map: byMap } }) {
  if (release) return "released";
  if (byMap?.admitted) return `in the map with grade ${byMap.grade} by the drives that it meets`;
  if (gate === "merge" && state === "done") return "merged into the map";
  return WORDS[gate];
}

export function verdict(drive) {
  const { grade } = drive.quality;
  return `${grade ? `Grade ${grade} by its own GNSS` : "No GNSS of its own"}, ${outcome(drive)}`;
}
