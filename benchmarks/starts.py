"""First frames with a motion: where they are placed when nothing is known of the motion, and what features change.

    python benchmarks/starts.py [--data FOLDER] [--drive FOLDER …] [--only NAME …] [--steps 1 2 3 5] [--every 4] [--write]

Each start is a drive of two frames, `step` frames apart, tracked twice: with features asked whatever the alignment says, and by the
rule of `wayloom.odometry.tracking.recovery`. A place is wrong where it lies more than 5 cm and 5 % of the way from the truth.

--drive  more drives with their own poses, as `wayloom simulate` writes them
--only   recordings of these names
--every  first frames, one in so many
--write  the table into docs/benchmarks/starts.md
"""

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from pages import DOCS, put_between_marks
from wayloom.evaluation.odometry_recordings import CLIP_A_WRONG_UNTIL, Recording, clip_recordings, recording_of, with_frames
from wayloom.geometry import se3
from wayloom.odometry.odometry import track
from wayloom.odometry.tracking import recovery, relocalisation

PAGE = DOCS / "benchmarks" / "starts.md"
WRONG_M, WRONG_SHARE = 0.05, 0.05
ALWAYS, RULE = 2.0, recovery.WELL_SEEN
"""Share of the keyframe that must be seen for a place to be taken without features."""
HEAD = "| recording | starts | features asked: always, by the rule | not placed | wrong | worse by the rule | better by it |"


@dataclass
class Counts:
    """Of some starts: those that asked for features, that were not placed, and whose place is wrong."""

    asked: int = 0
    lost: int = 0
    wrong: int = 0


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", "../shared/data")))
    parser.add_argument("--drive", type=Path, nargs="+", default=[])
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 2, 3, 5])
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    recordings = clip_recordings(options.data) if options.data.is_dir() else []
    recordings += [recording_of(path, f"{path.parent.name}/{path.name}") for path in options.drive]
    rows = [HEAD, "| --- " * HEAD.count(" |") + "|"]
    for recording in recordings:
        if not options.only or recording.name in options.only:
            rows.append(row(recording, options.steps, options.every))
            sys.stderr.write(rows[-1] + "\n")
    print("\n".join(rows))
    if options.write:
        put_between_marks(PAGE, "starts", "\n".join(rows) + "\n")


def row(recording: Recording, steps: list[int], every: int) -> str:
    """A recording's row of the table."""
    always, rule = Counts(), Counts()
    starts = worse = better = 0
    for step in steps:
        for first in first_frames(recording, step, every):
            good = [add_start(recording, first, first + step, seen, counts) for seen, counts in ((ALWAYS, always), (RULE, rule))]
            starts, worse, better = starts + 1, worse + (good == [True, False]), better + (good == [False, True])
    pairs = " | ".join(f"{a}, {b}" for a, b in zip(astuple(always), astuple(rule), strict=True))
    return f"| {recording.name} | {starts} | {pairs} | {worse} | {better} |"


def first_frames(recording: Recording, step: int, every: int) -> Iterator[int]:
    """First frames of starts; those of clip A whose poses are wrong are left out."""
    truth = next(iter(recording.truths.values()))
    for first in range(CLIP_A_WRONG_UNTIL if recording.name == "A" else 0, len(recording.log) - step, every):
        if np.isfinite(truth[[first, first + step]]).all():
            yield first


def add_start(recording: Recording, first: int, second: int, well_seen: float, counts: Counts) -> bool:
    """Track the two frames and count what comes out; returns whether the second is placed and not wrong."""
    truth = next(iter(recording.truths.values()))
    asked: list[bool] = []
    find = relocalisation.find_features

    def noted(*arguments: Any) -> relocalisation.Features:
        asked.append(True)
        return find(*arguments)

    with patch.object(relocalisation, "find_features", noted), patch.object(recovery, "WELL_SEEN", well_seen):
        found = track(with_frames(recording, np.array([first, second]), "start").log).trajectory
    true = se3.inverse(truth[first]) @ truth[second]
    way = float(np.linalg.norm(true[:3, 3]))
    off = float(np.linalg.norm((se3.inverse(found.T_world_cam[0]) @ found.T_world_cam[1] - true)[:3, 3]))
    placed, wrong = bool(found.tracked[1]), off > WRONG_M + WRONG_SHARE * way
    counts.asked += bool(asked)
    counts.lost += not placed
    counts.wrong += placed and wrong
    return placed and not wrong


if __name__ == "__main__":
    main()
