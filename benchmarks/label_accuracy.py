"""How right the labels of pixels and points are on a simulated drive with truth, before and after the vote.

    wayloom simulate demo --out /tmp/demo --truth
    python benchmarks/label_accuracy.py /tmp/demo/car-1 /tmp/demo/car-2 [--model NAME|FILE] [--json FILE]

Figures from simulated streets say nothing of real ones: they compare baseline, mono and stereo with each other.
"""

import argparse
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, VOID
from wayloom.labelling.tcl import label_points
from wayloom.logs.registry import open_log
from wayloom.odometry.odometry import track
from wayloom.odometry.types import Points
from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model
from wayloom.segmentation.network import Network
from wayloom.segmentation.stage import segment_keyframes

Labels = NDArray[np.uint8]


def main() -> None:
    """One table for each drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", type=Path, nargs="+")
    parser.add_argument("--model", default=DEFAULT_MODEL)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    network = Network(find_model(options.model))
    results = {drive.name: scores_of_drive(drive, network) for drive in options.drives}
    for name, rows in results.items():
        print(name)
        for row, (accuracy, miou) in rows.items():
            print(f"  {row:16} accuracy {accuracy:5.1f} %  mIoU {miou:5.1f} %")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


def scores_of_drive(drive: Path, network: Network) -> dict[str, tuple[float, float]]:
    """(accuracy, mean IoU) in percent of the keyframes' pixels and of the points' labels."""
    log = open_log(drive)
    odometry = track(log)
    frames = odometry.keyframes.frame
    truth = np.stack([read_truth(drive / "truth" / "class_left", int(index)) for index in frames])
    with tempfile.TemporaryDirectory() as folder:
        images = segment_keyframes(log, frames, network, Path(folder))
        pixels = np.stack([images.left(k) for k in range(len(frames))])
        labels = label_points(odometry, images)
    of_points = truth_of_points(odometry.points, truth)
    rows = {name: scores(of_points, getattr(labels, name)) for name in ("baseline", "mono", "stereo")}
    return {"pixels": scores(truth, pixels), **{f"points, {name}": row for name, row in rows.items()}}


def read_truth(folder: Path, index: int) -> Labels:
    """The true classes of one frame."""
    path = sorted(folder.glob("*.png"))[index]
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.uint8)


def truth_of_points(points: Points, truth: Labels) -> Labels:
    """(P,) the true class of each point's pixel in its host. truth: (K, h, w)."""
    u, v = np.floor(points.uv_host + 0.5).astype(int).T
    return truth[points.host, v, u]


def scores(truth: Labels, found: Labels) -> tuple[float, float]:
    """Accuracy and mean IoU over the classes present, in percent; where the truth is void nothing is judged."""
    known = truth != VOID
    pairs = truth[known].astype(int) * 256 + found[known]
    confusion = np.bincount(pairs, minlength=256 * 256)[: 256 * CLASS_COUNT].reshape(CLASS_COUNT, 256)
    hits = np.diag(confusion)
    union = confusion.sum(1) + confusion.sum(0)[:CLASS_COUNT] - hits
    present = confusion.sum(1) > 0
    return 100 * float(hits.sum() / confusion.sum()), 100 * float(np.mean(hits[present] / union[present]))


if __name__ == "__main__":
    main()
