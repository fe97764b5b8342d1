"""What right images are worth to the labels: `python benchmarks/right_images.py DATASET… [--source S] [--models M…] [--work DIR]`.

A DATASET is what `wayloom benchmark labels` takes; the drives of all are pooled. Each row labels the right image of every n-th
keyframe; images are what is left of the two of every keyframe, and with them the CPU of the segmentation.
docs/labelling-choices.md gives the commands that draw the datasets.
"""

import argparse
from pathlib import Path
from typing import Final

from labels import TRUTHS, drives_of
from real_labels import found_networks
from wayloom.evaluation.labels import LabelBenchmark, LabelBenchmarkSettings, benchmark_labels
from wayloom.labelling.settings import LabellingSettings
from wayloom.segmentation.catalogue import MODELS

EVERY: Final = (1, 2, 3, 4, 0)
HEAD: Final = (
    "| network | right images | images | mIoU | OA | mIoU, boundary points too | OA |\n| --- | --- | --- | --- | --- | --- | --- |"
)


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
        result = benchmark_labels(drives_of(options.datasets, options.source), network, settings, options.work)
        print("\n".join(row(result, every) for every in EVERY), flush=True)


def row(result: LabelBenchmark, every: int) -> str:
    """A line of the table."""
    share = 0.5 + (0.5 / every if every else 0.0)
    sure, whole = result.rows[str(every)], result.rows_with_boundaries[str(every)]
    said = {0: "none", 1: "all", 2: "every 2nd", 3: "every 3rd"}.get(every, f"every {every}th")
    return (
        f"| {result.model} | {said} | {100 * share:.0f} % | {sure.miou:.1f} | {sure.oa:.2f} | {whole.miou:.1f} | {whole.oa:.2f} |"
    )


if __name__ == "__main__":
    main()
