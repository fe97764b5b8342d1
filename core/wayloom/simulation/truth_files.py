"""Truth images beside a drive: depth, class and instance of both cameras."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.renderer import Truth

DEPTH_PER_M = 256
CAMERAS = ("left", "right")


def write_truth(folder: Path, index: int, truths: tuple[Truth, Truth]) -> None:
    """`{depth,class,instance}_{left,right}/%06d.png`: depth in 1/256 m, 0 for none and for more than 255 m; train ids; numbers."""
    for camera, truth in zip(CAMERAS, truths, strict=True):
        scaled = np.rint(truth.depth * DEPTH_PER_M)
        depth = np.where(scaled <= np.iinfo(np.uint16).max, scaled, 0).astype(np.uint16)
        for kind, image in (("depth", depth), ("class", truth.class_id), ("instance", truth.instance)):
            file = folder / f"{kind}_{camera}" / f"{index:06d}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(bytes(cv2.imencode(".png", image)[1]))


def write_poses_enu(file: Path, T_enu_cam: NDArray[np.float64]) -> None:
    """The first three rows of T_enu_cam (N, 4, 4), one line a frame, in the city's tangent plane."""
    lines = (" ".join(f"{v:.9f}" for v in T[:3].ravel()) for T in T_enu_cam)
    file.write_text("".join(line + "\n" for line in lines), encoding="ascii")
