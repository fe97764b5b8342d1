"""Votes a second of the labelling's kernels, and how much faster they are than the naive twin of the tests.

python benchmarks/labelling.py [--points 200000] [--json FILE]
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "labelling"))

from made_drive import made_drive, random_images
from test_tcl import naive_votes

from wayloom.labelling.settings import PAPER
from wayloom.labelling.tcl import label_points
from wayloom.odometry.types import Points

KEYFRAMES = 12


def main() -> None:
    """Measure, print one line for each, write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--twin-points", type=int, default=400)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rates = {"kernel": kernel_rate(options.points), "naive": naive_rate(options.twin_points)}
    result = {"votes_per_second": rates, "ratio": rates["kernel"] / rates["naive"], "points": options.points}
    print(f"kernels {rates['kernel']:.3g} votes/s, naive twin {rates['naive']:.3g} votes/s, ratio {result['ratio']:.0f}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def kernel_rate(points: int) -> float:
    """Images looked up a second by `label_points`, compiled and warm, the best of three."""
    images = random_images(1, KEYFRAMES)
    label_points(made_drive(1, KEYFRAMES, 100), images, PAPER)
    drive = made_drive(2, KEYFRAMES, points)
    return votes_of(drive.points) / min(timed(lambda: label_points(drive, images, PAPER)) for _ in range(3))


def naive_rate(points: int) -> float:
    """Images looked up a second by the twin."""
    images, drive = random_images(1, KEYFRAMES), made_drive(2, KEYFRAMES, points)
    return votes_of(drive.points) / timed(lambda: [naive_votes(drive, images, p, 2.0, True) for p in range(points)])


def votes_of(points: Points) -> int:
    """Label images looked up: the host's, its right one, the observers' and their right ones."""
    return len(points) + int(points.host_right.sum()) + len(points.obs_keyframe) + int(points.obs_right.sum())


def timed(work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
