// What is known of a drive in numbers, as rows of a table in the order of interest.

import { duration, many, metres, moment, size } from "/static/ui/words.js";

export function numbers({ fixes, bursts, receiver, scale, drift, loops }, facts) {
  const { log, georeference, odometry } = facts;
  const rows = [];
  if (log) {
    rows.push(["Log", `${log.format}, ${many(log.frames.count, "stereo pair")} in ${duration(log.frames.duration_s)}, ${size(log.bytes)}`]);
    rows.push(["Begin", log.start ?? moment(null)]);
    rows.push(["Camera", `${log.camera.width} × ${log.camera.height}, baseline ${log.camera.baseline_m.toFixed(3)} m`]);
  }
  if (odometry) rows.push(["Frames tracked", `${odometry.frames_tracked} of ${odometry.frames}, ${many(odometry.segments, "segment")}`]);
  if (fixes && georeference) rows.push(["Fixes used, not used", `${georeference.fixes.used}, ${georeference.fixes.rejected}`]);
  if (georeference?.residual_rms_m) rows.push(["Residuals, RMS", `${metres(georeference.residual_rms_m)} (east, north, up)`]);
  for (const burst of bursts) rows.push(["GNSS burst", `${burst.from_s.toFixed(1)} to ${burst.to_s.toFixed(1)} s, off by ${metres(burst.offset_enu_m)} (east, north, up)`]);
  if (receiver) {
    rows.push(["Time offset", `${(1e3 * receiver.time_offset_s).toFixed(1)} ± ${(1e3 * receiver.sigma_time_offset_s).toFixed(1)} ms`]);
    rows.push(["Lever arm, correction", `${metres(receiver.lever_correction_m)} ± ${metres(receiver.sigma_lever_m)} (right, down, forward)`]);
  }
  if (scale) rows.push(["Scale of the odometry", `${scale.mean.toFixed(4)} ± ${scale.sigma.toFixed(4)}`]);
  if (drift) {
    const { percent, deg_per_100m: turn } = drift;
    rows.push(["Drift of the odometry", `${percent.median.toFixed(2)} % (worst ${percent.worst.toFixed(2)}), ${turn.median.toFixed(2)}° (worst ${turn.worst.toFixed(2)}°) per 100 m`]);
  }
  rows.push(["Loop closures", loops ? String(loops.count) : "none"]);
  return rows;
}
