"""Heights of one view gathered by cell of the sheet."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def gather_heights(  # type: ignore[no-untyped-def]
    above,
    group,
    plane,
    first_row,
    camera,
    bf,
    bias,
    T_sheet_cam,
    reach,
    most,
    low,
    cell,
    shape,
    sums,
    counts,
    out_key,
    out_height,
    out_variance,
):
    """One sample for each cell and group that the view sees: the mean height of its pixels. Returns how many.

    above       (h, w) px over the ground plane (3,) of disparities, NaN without a match; its first row is `first_row` of the image
    group       (h, w) uint8: 0 is left out, 1 road, 2 ground beside it
    camera      (4,) fx, fy, cx, cy; bf px m; bias px; T_sheet_cam (4, 4)
    reach       m from the camera along its axis
    most        (3,) height of the camera over the plane, m; further from the plane than most[1] m + most[2] depth is no ground
    low         (2,) x and y of the grid's low corner; cells of `cell` m, `shape` (2,) rows and columns
    sums        (rows * columns * 2, 2) float64 and counts (rows * columns * 2,) int32: zero before and after
    Fills out_key int64 (2 * cell + group - 1), out_height m and out_variance m^2 of one pixel's height per px^2 of disparity.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    rows, columns = shape[0], shape[1]
    up = T_sheet_cam[2]
    count = 0
    for i in range(above.shape[0]):
        v = float(i + first_row)
        y = (v - cy) / fy
        for u in range(above.shape[1]):
            if group[i, u] == 0 or np.isnan(above[i, u]):
                continue
            disparity = plane[0] * u + plane[1] * v + plane[2] + above[i, u] - bias
            if disparity * reach < bf:
                continue
            z = bf / disparity
            if abs(above[i, u]) * most[0] > disparity * (most[1] + most[2] * z):
                continue
            x = (u - cx) / fx
            px = z * (T_sheet_cam[0, 0] * x + T_sheet_cam[0, 1] * y + T_sheet_cam[0, 2]) + T_sheet_cam[0, 3]
            py = z * (T_sheet_cam[1, 0] * x + T_sheet_cam[1, 1] * y + T_sheet_cam[1, 2]) + T_sheet_cam[1, 3]
            rise = z * (up[0] * x + up[1] * y + up[2])
            c, r = int(np.floor((px - low[0]) / cell)), int(np.floor((py - low[1]) / cell))
            if c < 0 or r < 0 or c >= columns or r >= rows:
                continue
            key = 2 * (r * columns + c) + int(group[i, u]) - 1
            if counts[key] == 0:
                out_key[count] = key
                count += 1
            counts[key] += 1
            sums[key, 0] += rise + up[3]
            sums[key, 1] += (rise / disparity) ** 2
    for n in range(count):
        key = out_key[n]
        out_height[n] = sums[key, 0] / counts[key]
        out_variance[n] = sums[key, 1] / counts[key]
        sums[key, 0] = sums[key, 1] = 0.0
        counts[key] = 0
    return count
