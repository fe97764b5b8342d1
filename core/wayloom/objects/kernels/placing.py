"""Place of a thing from all views that show it, by robust Gauss-Newton steps."""

import math

from wayloom.odometry.kernels.compiler import kernel
from wayloom.odometry.kernels.linear import cholesky_solve

ROUNDS = 8
SCALE = 2.0
"""Sigmas at which a measurement counts half."""
NEAREST_M = 0.5
LARGEST_STEP_M = 1.0
RIDGE = 1e-9
"""1/m^2 added to the information of each axis, so that it has an inverse."""


@kernel
def place_by_views(R, centre, camera, view, uvd, sigma, height, stands, place, H, off, space):  # type: ignore[no-untyped-def]
    """Move place (3,) m, level frame, to where the measurements of n views have it.

    R, centre  (V, 3, 3) from camera to level frame and (V, 3) m of all views
    camera     (5,) fx, fy, cx, cy, bf: px, the last px m
    view       (n,) rows of V
    uvd        (n, 3) px: columns, rows, disparities; sigma (n, 3) theirs
    height     (n,) m at which each view has the middle of what stands
    stands     of what stands, rows tell nothing, and the third axis is that of each view
    H          (axes, axes), two of what stands, else three: filled with the information 1/m^2 at the last step, RIDGE in it
    off        (n,) is filled with the root mean square of each residual r there: weights are 1 / (1 + (off / SCALE)^2)
    space      (7, 3), whatever is in it

    r = ((u, v, d) - (fx x / z + cx, fy y / z + cy, bf / z)) / sigma at x, y, z in the view's camera.
    """
    axes = H.shape[0]
    g, step, slope = space[0, :axes], space[1], space[2]
    for _ in range(ROUNDS):
        for i in range(axes):
            g[i] = 0.0
            for j in range(axes):
                H[i, j] = RIDGE if i == j else 0.0
        for k in range(view.shape[0]):
            row = view[k]
            east, north = place[0] - centre[row, 0], place[1] - centre[row, 1]
            up = (height[k] if stands else place[2]) - centre[row, 2]
            x = R[row, 0, 0] * east + R[row, 1, 0] * north + R[row, 2, 0] * up
            y = R[row, 0, 1] * east + R[row, 1, 1] * north + R[row, 2, 1] * up
            z = max(R[row, 0, 2] * east + R[row, 1, 2] * north + R[row, 2, 2] * up, NEAREST_M)
            u = (uvd[k, 0] - camera[0] * x / z - camera[2]) / sigma[k, 0]
            v = 0.0 if stands else (uvd[k, 1] - camera[1] * y / z - camera[3]) / sigma[k, 1]
            d = (uvd[k, 2] - camera[4] / z) / sigma[k, 2]
            off[k] = math.sqrt((u * u + v * v + d * d) / (2.0 if stands else 3.0))
            weight = 1.0 / (1.0 + (off[k] / SCALE) ** 2)
            for which in range(3):
                if which == 1 and stands:
                    continue
                residual, own, deep = u, camera[0], -camera[0] * x / z
                if which == 1:
                    residual, own, deep = v, camera[1], -camera[1] * y / z
                elif which == 2:
                    residual, own, deep = d, 0.0, -camera[4] / z
                for i in range(axes):
                    slope[i] = (own * R[row, i, which] + deep * R[row, i, 2]) / (z * sigma[k, which])
                    g[i] += weight * slope[i] * residual
                    for j in range(i + 1):
                        H[i, j] += weight * slope[i] * slope[j]
        for i in range(axes):
            for j in range(i):
                H[j, i] = H[i, j]
        if not cholesky_solve(H, g, step, space[3], space[4:7]):
            return
        for i in range(axes):
            place[i] += min(max(step[i], -LARGEST_STEP_M), LARGEST_STEP_M)
