"""Votes a second of the labelling, how much faster it is than the naive twin of the tests, and its share of a drive's time.

python benchmarks/labelling.py [--points 40000] [LOG …] [--model NAME] [--json FILE]

Each LOG is mapped as `wayloom process` does it; the share is of the processor time, exports and report among it.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "labelling"))

import numpy as np
from made_drive import CAMERA, HeldImages, made_drive, random_images, texture
from test_tcl import naive_votes

from wayloom.config.progress import Progress, silent
from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.odometry.types import OdometryResult, Points
from wayloom.pipeline.drive import process_drive
from wayloom.pipeline.settings import ProcessSettings
from wayloom.reports.drive_report import write_report
from wayloom.segmentation.scores import scores_from_logits
from wayloom.segmentation.settings import SegmentationSettings

KEYFRAMES = 25
"""As many as reach a point in the middle, by default."""


def main() -> None:
    """Measure, print one line for each, write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="*")
    parser.add_argument("--model", help="network for the logs")
    parser.add_argument("--points", type=int, default=40_000)
    parser.add_argument("--twin-points", type=int, default=400)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    drive = made_drive(2, KEYFRAMES, options.points)
    asked, projections = votes_of(drive.points), projections_of(drive.points)
    rates = {
        "paper": asked / seconds_of(drive, PAPER),
        "default": projections / seconds_of(drive, LabellingSettings()),
        "default, each point alone": projections / seconds_of(drive, LabellingSettings(spread=0.0)),
        "naive": naive_rate(options.twin_points),
    }
    result = {"votes_per_second": rates, "ratio": rates["paper"] / rates["naive"], "points": options.points}
    print(
        f"processor seconds: paper's form {rates['paper']:.3g} votes/s, default form {rates['default']:.3g} projections/s "
        f"({rates['default, each point alone']:.3g} without neighbours), "
        f"naive twin {rates['naive']:.3g} votes/s, ratio {result['ratio']:.0f}"
    )
    result["shares"] = {str(log): share_of(log, options.model) for log in options.logs}
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def seconds_of(drive: OdometryResult, settings: LabellingSettings) -> float:
    """Processor seconds of `label_points`, compiled and warm, the best of three."""
    images = images_with_scores()
    label_points(made_drive(1, KEYFRAMES, 100), images, settings)
    return min(timed(lambda: label_points(drive, images, settings)) for _ in range(3))


def images_with_scores() -> HeldImages:
    """Label images, their scores at a quarter of the size, and small images, as of a network without a void class."""
    images = random_images(1, KEYFRAMES)
    rng = np.random.default_rng(3)
    grid = (CAMERA.height // 4, CAMERA.width // 4, 19)
    ids = np.arange(19, dtype=np.uint8)
    scores = [
        scores_from_logits(rng.normal(0, 3, grid).astype(np.float32), ids, (CAMERA.height, CAMERA.width)) for _ in range(KEYFRAMES)
    ]
    images.likeliest, images.smalls = (scores, scores), [texture(0)] * KEYFRAMES
    images.is_balanced, images.may_be_void = False, False
    return images


def naive_rate(points: int) -> float:
    """Images looked up a second by the twin."""
    images, drive = random_images(1, KEYFRAMES), made_drive(2, KEYFRAMES, points)
    return votes_of(drive.points) / timed(lambda: [naive_votes(drive, images, p, 2.0, True) for p in range(points)])


def votes_of(points: Points) -> int:
    """Label images looked up: the host's, its right one, the observers' and their right ones."""
    return len(points) + int(points.host_right.sum()) + len(points.obs_keyframe) + int(points.obs_right.sum())


def projections_of(points: Points) -> int:
    """Images of keyframes within reach, left and right, that each point is projected into."""
    reach, host = LabellingSettings().reach, points.host.astype(np.int64)
    return 2 * int((np.minimum(host + reach, KEYFRAMES - 1) - np.maximum(host - reach, 0) + 1).sum())


class Clock:
    """Processor seconds of each stage: what passes until the next is told of."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._stage, self._since = "start", time.process_time()

    def __call__(self, stage: str) -> Progress:
        now = time.process_time()
        self.seconds[self._stage] += now - self._since
        self._stage, self._since = stage, now
        return silent


def share_of(log: Path, model: str | None) -> float:
    """Percent of the processor time of a whole drive that the labelling takes; the second run's, so that nothing is compiled."""
    for _ in range(2):
        clock = Clock()
        with tempfile.TemporaryDirectory() as folder:
            process_drive(
                log,
                Path(folder),
                ProcessSettings(segmentation=SegmentationSettings(model=model)),
                progress=clock,
                write_more=write_report,
            )
            clock("end")
    seconds = clock.seconds
    share = 100 * seconds["labelling"] / sum(seconds.values())
    print(f"{log}: labelling {share:.1f} % of " + ", ".join(f"{name} {s:.1f} s" for name, s in seconds.items()))
    return share


def timed(work: Callable[[], object]) -> float:
    """Processor seconds that a call takes."""
    started = time.process_time()
    work()
    return time.process_time() - started


if __name__ == "__main__":
    main()
