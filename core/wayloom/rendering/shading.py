"""Depth buffer of a scene from a viewpoint, and its eye-dome lighting."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.rendering.cameras import Viewpoint
from wayloom.rendering.kernels.splatting import eye_dome, splat

FloatImage = NDArray[np.float32]
STRENGTH: Final = 1.3
DIRECTIONS: Final = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
REACH_PX: Final = (1.0, 2.5)
"""Rings of neighbours, pixels of the finished picture."""
SOFT_M, SOFT_SHARE = 0.25, 0.004
"""Steps of depth well below it cast no shade: the noise of points is no relief."""
SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX = 0.9, 14.0
SUPERSAMPLING: Final = 2


@dataclass(frozen=True, slots=True)
class Buffer:
    """nearest (H, W) m, +inf where nothing is seen; shown (H, W) rows of the points, -1 likewise."""

    nearest: FloatImage
    shown: NDArray[np.int32]


def drawn(points: NDArray[np.float32], size_m: NDArray[np.float32], view: Viewpoint) -> Buffer:
    """Points (N, 3) m with edges (N,) m, drawn as discs."""
    uv, depth, scale = view.project(points)
    radius = np.clip(0.5 * size_m * scale, SMALLEST_RADIUS_PX * SUPERSAMPLING, LARGEST_RADIUS_PX * SUPERSAMPLING)
    width, height = view.size_px
    buffer = Buffer(np.full((height, width), np.inf, np.float32), np.full((height, width), -1, np.int32))
    splat(np.ascontiguousarray(uv, np.float32), depth.astype(np.float32), radius.astype(np.float32), buffer.nearest, buffer.shown)
    return buffer


def lit(buffer: Buffer, pixel_scale: int) -> FloatImage:
    """(H, W) brightness, 0 to 1: eye-dome lighting (Boucheny, 2009). A pixel is dark as far as its neighbours are nearer to the
    viewer: exp(-s mean over neighbours of max(0, z - z_n)), here softened and relative to depth, so that far things keep contours.

    pixel_scale : pixels of the buffer a pixel of the finished picture
    """
    steps = [(round(reach * pixel_scale * dx), round(reach * pixel_scale * dy)) for reach in REACH_PX for dx, dy in DIRECTIONS]
    shade = np.empty_like(buffer.nearest)
    eye_dome(buffer.nearest, np.array(steps, np.int64), SOFT_M, SOFT_SHARE, shade)
    return np.asarray(np.exp(-STRENGTH * shade), np.float32)
