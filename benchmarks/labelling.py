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

import numpy as np
from made_drive import CAMERA, HeldImages, made_drive, random_images, texture
from test_tcl import naive_votes

from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.odometry.types import OdometryResult, Points
from wayloom.segmentation.scores import scores_from_logits

KEYFRAMES = 12


def main() -> None:
    """Measure, print one line for each, write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--twin-points", type=int, default=400)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    drive = made_drive(2, KEYFRAMES, options.points)
    asked, projections = votes_of(drive.points), 2 * KEYFRAMES * options.points
    rates = {
        "paper": asked / seconds_of(drive, PAPER),
        "default": projections / seconds_of(drive, LabellingSettings()),
        "naive": naive_rate(options.twin_points),
    }
    result = {"votes_per_second": rates, "ratio": rates["paper"] / rates["naive"], "points": options.points}
    print(
        f"processor seconds: paper's form {rates['paper']:.3g} votes/s, default form {rates['default']:.3g} projections/s, "
        f"naive twin {rates['naive']:.3g} votes/s, ratio {result['ratio']:.0f}"
    )
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def seconds_of(drive: OdometryResult, settings: LabellingSettings) -> float:
    """Processor seconds of `label_points`, compiled and warm, the best of three."""
    images = images_with_scores()
    label_points(made_drive(1, KEYFRAMES, 100), images, settings)
    return min(timed(lambda: label_points(drive, images, settings)) for _ in range(3))


def images_with_scores() -> HeldImages:
    """Label images, their scores at a quarter of the size, and small images."""
    images = random_images(1, KEYFRAMES)
    rng = np.random.default_rng(3)
    grid = (CAMERA.height // 4, CAMERA.width // 4, 19)
    ids = np.arange(19, dtype=np.uint8)
    scores = [
        scores_from_logits(rng.normal(0, 3, grid).astype(np.float32), ids, (CAMERA.height, CAMERA.width)) for _ in range(KEYFRAMES)
    ]
    images.likeliest, images.smalls = (scores, scores), [texture(0)] * KEYFRAMES
    return images


def naive_rate(points: int) -> float:
    """Images looked up a second by the twin."""
    images, drive = random_images(1, KEYFRAMES), made_drive(2, KEYFRAMES, points)
    return votes_of(drive.points) / timed(lambda: [naive_votes(drive, images, p, 2.0, True) for p in range(points)])


def votes_of(points: Points) -> int:
    """Label images looked up: the host's, its right one, the observers' and their right ones."""
    return len(points) + int(points.host_right.sum()) + len(points.obs_keyframe) + int(points.obs_right.sum())


def timed(work: Callable[[], object]) -> float:
    """Processor seconds that a call takes."""
    started = time.process_time()
    work()
    return time.process_time() - started


if __name__ == "__main__":
    main()
