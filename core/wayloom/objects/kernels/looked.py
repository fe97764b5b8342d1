"""Raster of where a drive looked: cells that the view of a keyframe went through."""

import numpy as np
from numba import njit


@njit(cache=True)
def mark_looked(camera_xy, rays_xy, depth, nearest, cell, corner, looked, mark, number):  # type: ignore[no-untyped-def]
    """Count one keyframe in the cells of looked (H, W) uint8 that its rays go through.

    camera_xy (2,); rays_xy (n, 2) steps in the plane a metre of depth; depth (n,) m to which each is free; nearest: where they
    begin; mark (H, W) int32 holds the number of the keyframe that was counted last in a cell
    """
    rows, columns = looked.shape
    for k in range(len(depth)):
        length = np.sqrt(rays_xy[k, 0] ** 2 + rays_xy[k, 1] ** 2)
        step = 0.5 * cell / max(length, 1e-6)
        z = nearest
        while z <= depth[k]:
            column = int(np.floor((camera_xy[0] + z * rays_xy[k, 0]) / cell)) - corner[0]
            row = int(np.floor((camera_xy[1] + z * rays_xy[k, 1]) / cell)) - corner[1]
            if 0 <= row < rows and 0 <= column < columns and mark[row, column] != number:
                mark[row, column] = number
                if looked[row, column] < 255:
                    looked[row, column] += 1
            z += step
