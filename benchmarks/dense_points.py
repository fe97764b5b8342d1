"""Dense points of what stands beside the road against the sparse map's: how many, how far off, how much of the truth they show.

    python benchmarks/dense_points.py OUT LOG [--write]

OUT is what `wayloom process LOG` left of a drive that was simulated with truth. `wayloom process --dense` writes the voxels of
10 cm that two keyframes, two metres apart, tell of; the table has those of one and of three as well. All are placed by the true
poses of their submap and compared with what the truth images show: the distance of a point to the nearest true one, and the share
of true voxels near the track that have a point within 15 cm.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pages import DOCS, put_between_marks
from wayloom.dense.points import STANDING, VOXEL_M, dense_points
from wayloom.evaluation.ground import true_place
from wayloom.geometry import se3
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import SimulatedTruth, open_truth
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.submaps.files import load_submaps

PAGE = DOCS / "benchmarks" / "dense_points.md"
TRUE_REACH_M, NEAR_M, WRONG_M = 24.0, 15.0, 0.15
TRUE_STEP = 2
"""Of the truth's frames and pixels, so many are taken."""


def dense(out: Path, log_path: Path, truth: SimulatedTruth) -> tuple[dict[int, np.ndarray], float]:
    """Points (N, 3) ENU by how many keyframes told of their voxel, at least, and CPU seconds."""
    log, odometry = open_log(log_path), load_odometry(out / "stages" / "odometry" / "odometry.npz")
    images = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame)
    submaps, start = load_submaps(out / "stages" / "submaps"), time.process_time()
    found = list(dense_points(log, odometry, images, [item.submap for item in submaps], least=1))
    cpu = time.process_time() - start
    points = [se3.transform(true_place(item.submap, truth.T_enu_cam), one.xyz) for item, one in zip(submaps, found, strict=True)]
    return {
        least: np.concatenate([xyz[one.keyframes >= least] for xyz, one in zip(points, found, strict=True)]) for least in (1, 2, 3)
    }, cpu


def thinned(points: np.ndarray) -> np.ndarray:
    """Of points (N, 3), the first in each voxel."""
    return points[np.sort(np.unique(np.floor(points / VOXEL_M).astype(np.int64), axis=0, return_index=True)[1])]


def true_points(truth: SimulatedTruth, log_path: Path) -> np.ndarray:
    """(N, 3) ENU: what the truth images show of things that stand and stay, one point in half a voxel."""
    camera, parts = open_log(log_path).rig.camera, []
    v, u = np.mgrid[0 : camera.height : TRUE_STEP, 0 : camera.width].reshape(2, -1).astype(np.float64)
    rays = camera.rays(np.column_stack([u, v]))
    for frame in range(0, len(truth.T_enu_cam), TRUE_STEP):
        depth, label = (image[::TRUE_STEP].ravel() for image in (truth.depth_m(frame), truth.class_id(frame)))
        seen = np.isin(label, STANDING) & (depth > 0.0) & (depth < TRUE_REACH_M)
        points = se3.transform(truth.T_enu_cam[frame], rays[seen] * depth[seen, None])
        cells = np.floor(points / (VOXEL_M / 2)).astype(np.int64)
        parts.append(points[np.unique(cells, axis=0, return_index=True)[1]])
    points = np.concatenate(parts)
    return points[np.unique(np.floor(points / (VOXEL_M / 2)).astype(np.int64), axis=0, return_index=True)[1]]


def table(out: Path, log_path: Path) -> str:
    """Markdown."""
    truth = open_truth(log_path)
    kinds, cpu = dense(out, log_path, truth)
    sparse = []
    for item in load_submaps(out / "stages" / "submaps"):
        there = np.isin(item.submap.label, STANDING)
        sparse.append(se3.transform(true_place(item.submap, truth.T_enu_cam), item.submap.xyz[there].astype(np.float64)))
    true = true_points(truth, log_path)
    tree, track = cKDTree(true), cKDTree(truth.T_enu_cam[:, :3, 3])
    coarse = thinned(true)
    coarse = coarse[track.query(coarse)[0] < NEAR_M]
    names = {1: "dense, one keyframe", 2: "dense, two keyframes", 3: "dense, three keyframes"}
    rows = {"sparse map": np.concatenate(sparse), **{names[least]: points for least, points in kinds.items()}}
    lines = [
        "| points | a metre of road | off the truth (cm): median, p90 | further than 15, 30 cm (%) | true voxels shown (%) |",
        "| --- | --- | --- | --- | --- |",
    ]
    road = float(np.linalg.norm(np.diff(truth.T_enu_cam[:, :3, 3], axis=0), axis=1).sum())
    for name, points in rows.items():
        off = tree.query(points)[0]
        shown = np.mean(cKDTree(points).query(coarse, distance_upper_bound=WRONG_M)[0] < WRONG_M)
        lines.append(
            f"| {name} | {len(points) / road:.0f} | {100 * np.median(off):.1f}, {100 * np.percentile(off, 90):.1f} |"
            f" {100 * np.mean(off > WRONG_M):.1f}, {100 * np.mean(off > 2 * WRONG_M):.1f} | {100 * shown:.1f} |"
        )
    laz, count = (out / "cloud.laz").stat().st_size, sum(len(item.submap) for item in load_submaps(out / "stages" / "submaps"))
    lines += ["", f"Dense depth and voxels: {1e3 * cpu / len(truth.T_enu_cam):.0f} CPU ms a frame."]
    return "\n".join(lines) + f" A point of cloud.laz: {laz / count:.1f} bytes.\n"


def main() -> None:
    """Measure, print, and write where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("log", type=Path)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    text = table(asked.out, asked.log)
    print(text)
    if asked.write:
        put_between_marks(PAGE, "dense_points", text)


if __name__ == "__main__":
    main()
