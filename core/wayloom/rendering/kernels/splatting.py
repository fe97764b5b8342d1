"""Z-buffer splatting of points as discs."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, error_model="numpy")
def splat(
    uv: NDArray[np.float32],
    depth: NDArray[np.float32],
    radius: NDArray[np.float32],
    nearest: NDArray[np.float32],
    shown: NDArray[np.int32],
) -> None:
    """Draw P points as discs that face the viewer, the nearest in each pixel, in place.

    uv (P, 2) px of their middles; depth (P,) m, positive; radius (P,) px, those under half a pixel take one pixel
    nearest (H, W) m, +inf where nothing is; shown (H, W) row of the point that is seen, -1 where none is. Of equally near points
    the first one is kept. A point that is not in front of the viewer, or is NaN, is left out.
    """
    height, width = nearest.shape
    for p in range(len(depth)):
        z = depth[p]
        if not z > 0.0:
            continue
        u, v, r = uv[p, 0], uv[p, 1], max(radius[p], np.float32(0.5))
        if not (u + r >= 0.0 and v + r >= 0.0 and u - r <= width and v - r <= height):
            continue
        for row in range(max(int(np.ceil(v - r)), 0), min(int(np.floor(v + r)), height - 1) + 1):
            for column in range(max(int(np.ceil(u - r)), 0), min(int(np.floor(u + r)), width - 1) + 1):
                if (column - u) ** 2 + (row - v) ** 2 <= r * r + 1e-6 and z < nearest[row, column]:
                    nearest[row, column] = z
                    shown[row, column] = p


@njit(cache=True, error_model="numpy")
def eye_dome(
    nearest: NDArray[np.float32], steps: NDArray[np.int64], soft_m: float, soft_share: float, light: NDArray[np.float32]
) -> None:
    """The mean step of depth from each pixel to nearer neighbours, each at most 1.5 softnesses, in place.

    nearest (H, W) m, +inf where nothing is seen; light (H, W), 0 where nothing is seen
    steps (S, 2) columns and rows to the neighbours; beyond the edge and where nothing is seen there is no step
    soft_m, soft_share : softness is soft_m + soft_share times the pixel's depth
    """
    height, width = nearest.shape
    for row in range(height):
        for column in range(width):
            z = nearest[row, column]
            light[row, column] = 0.0
            if z == np.inf:
                continue
            total, softness = 0.0, soft_m + soft_share * z
            for s in range(len(steps)):
                x, y = column + steps[s, 0], row + steps[s, 1]
                if 0 <= x < width and 0 <= y < height:
                    total += min(max((z - nearest[y, x]) / softness, 0.0), 1.5)
            light[row, column] = total / len(steps)
