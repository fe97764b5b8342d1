"""Pixels of a view that stand above the surface of the ground where their own depth puts them."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def stands(  # type: ignore[no-untyped-def]
    above,
    first_row,
    plane,
    camera,
    bf,
    bias,
    camera_height,
    T_sheet_cam,
    reach,
    height,
    low,
    cell,
    least,
    least_unknown,
    noise,
    out,
    foot,
):
    """Fill out (h', w) bool, foot (h', w) int32 of a view's pixels above (h', w) px, as `GroundView` has them.

    A pixel stands if it is higher than `least` m, and `noise` px of disparity, over the height (rows, columns) m of its own cell;
    where that is NaN, or outside, than `least_unknown` over the view's plane. What is beyond reach, or has no match, does not.
    foot : rows between a pixel that stands by just these limits and the ground
    """
    rows, columns = height.shape
    T = T_sheet_cam
    for i in range(above.shape[0]):
        for j in range(above.shape[1]):
            out[i, j], foot[i, j] = False, 0
            e = above[i, j]
            d = plane[0] * j + plane[1] * (i + first_row) + plane[2] + e - bias
            if np.isnan(e) or d * reach < bf:
                continue
            depth, lift = bf / d, camera_height / d
            a, b = depth * (j - camera[2]) / camera[0], depth * (i + first_row - camera[3]) / camera[1]
            x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * depth + T[0, 3]
            y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * depth + T[1, 3]
            z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * depth + T[2, 3]
            c, r = int(np.floor((x - low[0]) / cell)), int(np.floor((y - low[1]) / cell))
            if 0 <= c < columns and 0 <= r < rows and not np.isnan(height[r, c]):
                rise, limit = z - height[r, c], least + noise * lift
            else:
                rise, limit = e * lift, least_unknown + noise * lift
            if rise > limit:
                out[i, j], foot[i, j] = True, int(np.ceil(camera[1] * limit / depth))


@njit(cache=True, error_model="numpy", nogil=True)
def add_feet(standing, foot, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w) bool: the standing pixels, and below the lowest of them in a column, or over a gap, `foot` more."""
    rows, columns = standing.shape
    for j in range(columns):
        left = 0
        for i in range(rows):
            if standing[i, j]:
                left = foot[i, j]
                out[i, j] = True
            else:
                out[i, j] = left > 0
                left -= 1
