"""Makes the tables of docs/results.md: `python benchmarks/real_clips.py [--data FOLDER] [--json FILE] [--write]`, or `make bench`.

FOLDER holds the recordings as docs/results.md describes them; default is what WAYLOOM_DATA names, else ../shared/data.
--write puts the tables into docs/results.md, between its two marks.
"""

import argparse
import json
import os
import sys
from pathlib import Path

from pages import DOCS, put_between_marks
from wayloom.evaluation.georeference import TrackDistance
from wayloom.evaluation.recordings import RecordingRow, measure_kitti_odometry, measure_kitti_raw

ROOT = Path(__file__).resolve().parents[1]
RESULTS = DOCS / "results.md"


def measured(data: Path) -> list[RecordingRow]:
    """One row a recording."""
    oxts = data / "kitti_oxts" / "2011_10_03" / "2011_10_03_drive_0027_sync"
    return [
        measure_kitti_odometry(data / "kitti_odometry" / "sequences" / "00", oxts, "A", fault_until=16),
        measure_kitti_raw(data / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync", "B"),
    ]


def table(rows: list[RecordingRow]) -> str:
    """Two Markdown tables: the odometry against truth, the map against the INS."""
    lines = [
        "| clip | truth | frames tracked | segments | ATE (m) | t_rel (%) | r_rel (°/100 m) | length ratio | disparity bias (px) |"
        " CPU ms a frame | points a metre |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        for truth, e in row.errors.items():
            tracked = f"{row.tracked} of {row.frames} | {row.segments}"
            error = f"{e.ate_m:.3f} | {e.t_rel_percent:.2f} | {e.r_rel_deg_per_100m:.2f} | {e.length_ratio:.4f}"
            rest = f"{row.disparity_bias_px:.2f} | {row.cpu_ms_per_frame:.0f} | {row.points_per_m:.0f}"
            lines.append(f"| {row.name} | {truth} | {tracked} | {error} | {rest} |")
    lines += [
        "",
        "| clip | fixes given | horizontal (m): median, p95, max | vertical (m): median, p95, max |",
        "| --- | --- | --- | --- |",
    ]
    for row in rows:
        lines += [distance_line(row.name, given, d) for given, d in (("all", row.to_ins), ("one in 20", row.to_ins_sparse)) if d]
    return "\n".join(lines) + "\n"


def distance_line(name: str, given: str, distance: TrackDistance) -> str:
    """One row of the second table."""
    h, v = distance.horizontal, distance.vertical
    return f"| {name} | {given} | {h.median_m:.3f}, {h.p95_m:.3f}, {h.max_m:.3f} | {v.median_m:.3f}, {v.p95_m:.3f}, {v.max_m:.3f} |"


def main() -> None:
    """Measure, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT.parent / "shared" / "data")))
    parser.add_argument("--json", type=Path, help="also write all numbers to this file")
    parser.add_argument("--write", action="store_true", help="put the table into docs/results.md")
    options = parser.parse_args()
    if not options.data.is_dir():
        sys.exit(f"no folder {options.data}: set WAYLOOM_DATA or give --data")
    rows = measured(options.data)
    if not all(row.same_twice for row in rows):
        sys.exit("two runs of one recording gave different trajectories")
    text = table(rows)
    print(text, end="")
    if options.json:
        options.json.write_text(json.dumps([row.as_json() for row in rows], indent=1) + "\n")
    if options.write:
        put_between_marks(RESULTS, "real clips", text)


if __name__ == "__main__":
    main()
