"""Points against looks: which of them a camera saw, saw through, or could not see."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Codes = NDArray[np.uint8]
NO_WORD, AGREES, THROUGH, HIDDEN, BARE, PAST = range(6)
MOVING_BIT = 1
"""`wayloom.dense.types.MOVING`."""
NEAREST_M = 2.0
"""Nearer things fill the image and are not matched."""
WIDEST_PX = 3.0
"""A point whose place in a look is less sure than that is not looked for."""


@njit(cache=True, error_model="numpy")
def window(codes_near, codes_far, kinds, v0, v1, u0, u1, own_kinds, nearest, furthest, inverse):  # type: ignore[no-untyped-def]
    """What the patches v0 to v1 and u0 to u1, these included, say of a point of the kinds `own_kinds` (bits) at inverse depths
    `furthest` to `nearest` 1/m: how many there are, how many are wholly before it, how many wholly beyond, how many may be it (of
    its kind and at its depth), how many are sure; and the kinds of all.
    """
    count, before, beyond, fits, sure, bits = 0, 0, 0, 0, 0, 0
    for v in range(v0, v1 + 1):
        for u in range(u0, u1 + 1):
            count += 1
            bits |= int(kinds[v, u])
            if codes_near[v, u] == 0:
                continue
            sure += 1
            if inverse[codes_far[v, u]] > nearest:
                before += 1
            elif inverse[codes_near[v, u]] < furthest:
                beyond += 1
            elif int(kinds[v, u]) & own_kinds != 0:
                fits += 1
    return count, before, beyond, fits, sure, bits


@njit(cache=True, error_model="numpy")
def verdict(count, before, beyond, fits, sure, bits, own_kinds):  # type: ignore[no-untyped-def]
    """What a window, counted as by `window`, says of a point of the kinds `own_kinds` (bits).

    It agrees where a patch may be the point. The point is seen through where all patches are sure and beyond it, of other kinds
    than its own (PAST: of its own too, as a car behind a car). It is bare where nothing is before it, of its kinds or moves, but
    depth does not tell.
    """
    own, moves = bits & own_kinds != 0, bits & MOVING_BIT != 0
    if fits > 0:
        return AGREES
    if beyond == count:
        return PAST if own else THROUGH
    if before > 0:
        return HIDDEN if before == sure else NO_WORD
    return NO_WORD if own or moves else BARE


@njit(cache=True, error_model="numpy")
def look_at(
    xyz: FloatArray,
    variance: FloatArray,
    own_kinds: Codes,
    T_cam_map: FloatArray,
    look_variance: FloatArray,
    camera: FloatArray,
    near: Codes,
    far: Codes,
    kinds: Codes,
    inverse: FloatArray,
    limits: FloatArray,
    out: Codes,
) -> None:
    """Fill out (N, P) with what N looks say of P points.

    xyz (P, 3) m; variance (P,) m^2 of the points' places across the rays, own_kinds (P,) bits; T_cam_map (N, 4, 4),
    look_variance (N,) m^2, camera fx, fy, cx, cy, near, far, kinds (N, h, w); inverse (256,) 1/m of the codes; limits: furthest
    from the camera m, sigmas that count, slack m, sigma of inverse depth 1/m
    """
    furthest, gate, slack_m, sigma_inverse = limits
    height, width = near.shape[1], near.shape[2]
    for n in range(len(near)):
        T = T_cam_map[n]
        for p in range(len(xyz)):
            out[n, p] = NO_WORD
            z = T[2, 0] * xyz[p, 0] + T[2, 1] * xyz[p, 1] + T[2, 2] * xyz[p, 2] + T[2, 3]
            if not (NEAREST_M <= z <= furthest):
                continue
            x = T[0, 0] * xyz[p, 0] + T[0, 1] * xyz[p, 1] + T[0, 2] * xyz[p, 2] + T[0, 3]
            y = T[1, 0] * xyz[p, 0] + T[1, 1] * xyz[p, 1] + T[1, 2] * xyz[p, 2] + T[1, 3]
            if x * x + y * y + z * z > furthest * furthest:
                continue
            u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
            spread = gate * np.sqrt(variance[p] + look_variance[n])
            radius = spread * camera[0] / z
            if radius > WIDEST_PX:
                continue
            u0, u1 = np.floor(u - radius + 0.5), np.floor(u + radius + 0.5)
            v0, v1 = np.floor(v - radius + 0.5), np.floor(v + radius + 0.5)
            if u0 < 0 or v0 < 0 or u1 >= width or v1 >= height:
                continue
            slack, sigma = slack_m + spread, gate * sigma_inverse
            nearest = 1.0 / (z - slack) + sigma if slack < z else np.inf
            count, before, beyond, fits, sure, bits = window(
                near[n], far[n], kinds[n], int(v0), int(v1), int(u0), int(u1), int(own_kinds[p]), nearest,
                1.0 / (z + slack) - sigma, inverse,
            )  # fmt: skip
            out[n, p] = verdict(count, before, beyond, fits, sure, bits, int(own_kinds[p]))
