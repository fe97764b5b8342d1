"""Density and coverage of the odometry's points."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import OdometryResult

BLOCK_PX = 32
TEXTURE_GREY, TEXTURE_PIXELS = 10.0, 10
"""A block has texture where so many of its pixels have a gradient of so many grey levels a pixel."""
HORIZONTAL_RATIO = 2.0
"""A point lies on a horizontal edge where the gradient along y is so many times that along x."""
EVERY_KEYFRAME = 5


@dataclass(frozen=True, slots=True)
class Density:
    """points of the result for each metre of way; of the blocks of 32x32 px that have texture, the share that hold a point, median
    over keyframes; the share of points on horizontal edges. NaN where there is nothing to count."""

    points_per_m: float
    blocks_covered: float
    horizontal_edges: float


def grey_of(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(h, w) or (h, w, 3) RGB uint8 to (h, w) float32."""
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)


def slopes(grey: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Central differences (h, w) along x and y."""
    dy, dx = np.gradient(grey)
    return np.asarray(dx, np.float32), np.asarray(dy, np.float32)


def textured_blocks(dx: NDArray[np.float32], dy: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(rows, columns) of whole blocks, from slopes (h, w)."""
    rows, columns = dx.shape[0] // BLOCK_PX, dx.shape[1] // BLOCK_PX
    strong = (np.hypot(dx, dy) > TEXTURE_GREY)[: rows * BLOCK_PX, : columns * BLOCK_PX]
    return np.asarray(strong.reshape(rows, BLOCK_PX, columns, BLOCK_PX).sum(axis=(1, 3)) >= TEXTURE_PIXELS)


def points_in_keyframe(result: OdometryResult, keyframe: int) -> NDArray[np.float64]:
    """(n, 2) px: the points that a keyframe hosts or really saw, in its left image."""
    p = result.points
    point_of = np.repeat(np.arange(len(p)), np.diff(p.obs_start))
    seen = np.union1d(np.flatnonzero(p.host == keyframe), point_of[p.obs_keyframe == keyframe])
    p_world = result.points_world()[seen]
    uv = result.rig.camera.project(se3.transform(se3.inverse(result.keyframes.T_world_cam[keyframe]), p_world))
    return np.asarray(uv[result.rig.camera.contains(uv)])


def covered(texture: NDArray[np.bool_], uv: NDArray[np.float64]) -> float:
    """Share of the textured blocks (rows, columns) that hold one of the pixels uv (n, 2); NaN without texture."""
    column, row = (np.rint(uv) // BLOCK_PX).astype(int).T
    whole = (row < texture.shape[0]) & (column < texture.shape[1])
    holds = np.zeros_like(texture)
    holds[row[whole], column[whole]] = True
    return float(holds[texture].mean()) if texture.any() else float("nan")


def density(result: OdometryResult, log: DriveLog, way_m: float) -> Density:
    """Of a tracked log; every fifth keyframe's image is looked at."""
    shares, horizontal, p = [], [], result.points
    for k in range(0, len(result.keyframes), EVERY_KEYFRAME):
        dx, dy = slopes(grey_of(log.frame(int(result.keyframes.frame[k])).left))
        shares.append(covered(textured_blocks(dx, dy), points_in_keyframe(result, k)))
        u, v = np.rint(p.uv_host[p.host == k]).astype(int).T
        horizontal.append(np.abs(dy[v, u]) > HORIZONTAL_RATIO * np.abs(dx[v, u]))
    edges = np.concatenate([*horizontal, np.zeros(0, bool)])
    known = np.array(shares)[np.isfinite(shares)]
    return Density(
        len(p) / max(way_m, 1.0),
        float(np.median(known)) if len(known) else float("nan"),
        float(edges.mean()) if len(edges) else float("nan"),
    )
