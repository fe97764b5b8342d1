"""What right images are worth to the labels: `python benchmarks/right_images.py DATASET… [--source S] [--models M…] [--work DIR]`.

A DATASET is what `wayloom benchmark labels` takes; the drives of all are pooled. Each row labels the right image of every n-th
keyframe; images are what is left of the two of every keyframe, and with them the CPU of the segmentation. Differences are from the
row with all of them, with the interval that holds 95 % of resamples of the drives' pieces of 10 m.
docs/labelling-choices.md gives the commands that draw the datasets.
"""

import argparse
import sys
from collections import defaultdict
from pathlib import Path
from typing import Final

from labels import TRUTHS, drives_of
from real_labels import found_networks
from wayloom.evaluation.label_gains import Gain, Tally, gain, pieces, pooled, tally
from wayloom.evaluation.labels import LabelBenchmark, LabelBenchmarkSettings, LabelledPoints, benchmark_labels
from wayloom.labelling.settings import LabellingSettings
from wayloom.segmentation.catalogue import MODELS

EVERY: Final = (1, 2, 3, 4, 0)
ALL: Final = str(EVERY[0])
HEAD: Final = (
    "| network | right images | images | mIoU | difference | OA | mIoU, boundary points too | difference | OA |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- | --- |"
)


class Differences:
    """Takes each labelled drive; `of` gives a row's mIoU less that of all right images."""

    def __init__(self) -> None:
        self._tallies: dict[tuple[str, int], list[Tally]] = defaultdict(list)

    def take(self, done: LabelledPoints) -> None:
        """Count the drive's points by piece of street."""
        piece, judged = pieces(done.odometry), (done.matches.judged, done.matches.judged_with_boundaries)
        for every in map(str, EVERY):
            for kind, points in enumerate(judged):
                truth, found = done.matches.truth[points], done.labels[every][points]
                self._tallies[every, kind].append(tally(truth, found, piece[points]))

    def of(self, every: int, kind: int) -> str:
        """In words. kind : 0 without points at boundaries, 1 with them."""
        if str(every) == ALL:
            return "–"
        less: Gain = gain(pooled(self._tallies[str(every), kind]), pooled(self._tallies[ALL, kind]))
        return f"{less.miou:+.1f} ({less.low:+.1f} to {less.high:+.1f})"


def main() -> None:
    """Print a row for each network and number."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--source", choices=list(TRUTHS), default="auto", help="of the truth")
    parser.add_argument("--models", nargs="+", default=list(MODELS), help="names of the catalogue, or TOML files")
    parser.add_argument("--work", type=Path, help="keep tracks and label images here")
    options = parser.parse_args()
    settings = LabelBenchmarkSettings(variants={str(every): LabellingSettings(right_images=every) for every in EVERY})
    print(HEAD)
    for network in found_networks(options.models):
        less = Differences()
        result = benchmark_labels(drives_of(options.datasets, options.source), network, settings, options.work, show=less.take)
        print("\n".join(row(result, less, every) for every in EVERY), flush=True)
        print(f"{result.rows[ALL].points} points of {len(result.drives)} drives", file=sys.stderr, flush=True)


def row(result: LabelBenchmark, less: Differences, every: int) -> str:
    """A line of the table."""
    share = 0.5 + (0.5 / every if every else 0.0)
    sure, whole = result.rows[str(every)], result.rows_with_boundaries[str(every)]
    said = {0: "none", 1: "all", 2: "every 2nd", 3: "every 3rd"}.get(every, f"every {every}th")
    return (
        f"| {result.model} | {said} | {100 * share:.0f} % | {sure.miou:.1f} | {less.of(every, 0)} | {sure.oa:.2f} "
        f"| {whole.miou:.1f} | {less.of(every, 1)} | {whole.oa:.2f} |"
    )


if __name__ == "__main__":
    main()
