"""Makes the tables of docs/results.md on labels of real images: `python benchmarks/real_labels.py [--write] [--pictures DIR]`.

The recordings lie where WAYLOOM_DATA says (default ../shared/data), the networks where WAYLOOM_MODELS says. --write puts the tables
into docs/results.md between their marks; --pictures draws single image and vote over keyframes of the clips.
"""

import argparse
import os
import tempfile
from pathlib import Path

import cv2
import numpy as np

from pages import put_between_marks
from real_clips import RESULTS, ROOT
from wayloom.calibration.self_calibration import track_calibrated
from wayloom.config.classes import PALETTE_WITH_VOID
from wayloom.errors import ModelError
from wayloom.evaluation.label_consistency import Consistency, consistency
from wayloom.evaluation.label_truth import part_of
from wayloom.evaluation.labelled_images import scores_on_camvid, scores_on_kitti
from wayloom.labelling.settings import PAPER
from wayloom.labelling.tcl import label_points
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.catalogue import MODELS, find_model
from wayloom.segmentation.network import Network
from wayloom.segmentation.stage import segment_keyframes

CLIPS = {"A (grey)": "kitti_odometry/sequences/00", "B (colour)": "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"}


def main() -> None:
    """Measure, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT.parent / "shared" / "data")))
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--models", nargs="+", default=list(MODELS), help="names of the catalogue")
    parser.add_argument("--frames", type=int, help="of each clip; default all")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/results.md")
    options = parser.parse_args()
    networks = found_networks(options.models)
    lines = ["| network | KITTI, 5 frames: mIoU / accuracy | CamVid, 39 frames: mIoU / accuracy |", "| --- | --- | --- |"]
    for network in networks:
        kitti = scores_on_kitti(network, options.data / "labelled" / "kitti")
        camvid = scores_on_camvid(network, options.data / "labelled" / "camvid")
        cells = " | ".join(f"{s.miou:.1f} / {s.accuracy:.1f}" for s in (kitti, camvid))
        lines.append(f"| {network.description.name} | {cells} |")
        print(lines[-1], flush=True)
    lines += [
        "",
        "| clip | network | flips between observers | neighbours disagree: single image | TCL mono | TCL stereo | default |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, folder in CLIPS.items():
        log = part_of(open_log(options.data / folder), 0, options.frames)
        odometry = track_calibrated(log)
        for network in networks:
            measured = labelled(log, odometry, network, options.pictures, name[0])
            share = [f"{100 * measured.disagreement[row]:.2f} %" for row in ("baseline", "mono", "stereo", "best")]
            lines.append(f"| {name} | {network.description.name} | {100 * measured.flips:.2f} % | {' | '.join(share)} |")
            print(lines[-1], flush=True)
    if options.write:
        put_between_marks(RESULTS, "real labels", "\n".join(lines) + "\n")


def found_networks(names: list[str]) -> list[Network]:
    """Those of the catalogue whose files are here."""
    found = []
    for name in names:
        try:
            found.append(Network(find_model(name), 2))
        except ModelError as error:
            print(error)
    return found


def labelled(log: DriveLog, odometry: OdometryResult, network: Network, pictures: Path | None, clip: str) -> Consistency:
    """Label one clip by one network, measure, draw."""
    with tempfile.TemporaryDirectory() as folder:
        images = segment_keyframes(log, odometry.keyframes.frame, network, Path(folder))
        paper, best = label_points(odometry, images, PAPER), label_points(odometry, images)
        labels = {"baseline": paper.baseline, "mono": paper.mono, "stereo": paper.stereo, "best": best.stereo}
        if pictures:
            pictures.mkdir(parents=True, exist_ok=True)
            for k in np.linspace(0, len(odometry.keyframes) - 1, 5).astype(int)[1:4].tolist():
                drawn = [panel(log, odometry, k, labels[row]) for row in ("baseline", "best")]
                file = pictures / f"clip-{clip}-{network.description.name}-{k:04d}.png"
                cv2.imwrite(str(file), np.concatenate(drawn)[..., ::-1])
        return consistency(odometry, images, labels)


def panel(log: DriveLog, odometry: OdometryResult, k: int, labels: np.ndarray) -> np.ndarray:
    """(h, w, 3) RGB: the labels of the points of keyframe k and its neighbours over its image."""
    left = log.frame(int(odometry.keyframes.frame[k])).left
    picture = (0.6 * (left if left.ndim == 3 else np.repeat(left[:, :, None], 3, axis=2))).astype(np.uint8)
    rows = np.flatnonzero(odometry.points.host == k)
    for p in rows.tolist():
        u, v = (round(float(x)) for x in odometry.points.uv_host[p])
        cv2.circle(picture, (u, v), 3, tuple(int(c) for c in PALETTE_WITH_VOID[labels[p]]), -1, cv2.LINE_AA)
    return picture


if __name__ == "__main__":
    main()
