"""Patches of a depth image: disparities that both images agree on, depths as codes, and a patch's nearest, furthest and kinds."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
UNSURE, INFINITY = 0, 255


@njit(cache=True, error_model="numpy", nogil=True)
def keep_returning(there: FloatArray, back: FloatArray, check_px: float, sure: FloatArray) -> None:
    """Fill sure (h, w) with the disparities of the left image that the right one's lead back from to within check_px, NaN else.

    there : (h, w) px of the left image's pixels; not positive without a match
    back  : (h, w) px of the right image's, whose columns run from the right to the left
    """
    rows, columns = there.shape
    for y in range(rows):
        for x in range(columns):
            disparity = there[y, x]
            sure[y, x] = math.nan
            if disparity > 0.0:
                u_right = int(np.rint(x - disparity))
                if u_right >= 0:
                    returned = back[y, columns - 1 - u_right]
                    if returned > 0.0 and abs(disparity - returned) <= check_px:
                        sure[y, x] = disparity


@njit(cache=True, error_model="numpy", nogil=True)
def encode_depths(depth: FloatArray, depths: FloatArray, near_code: Image, far_code: Image) -> None:
    """Fill near_code, far_code (h, w) with the code of the next of depths (n,), increasing, towards the camera, and away from it.

    Code c is depths[c - 1], at least the first one; UNSURE for NaN, INFINITY for what is further than all.
    """
    count = 0  # of depths that are not further than the pixel: from its neighbour's on
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            here = depth[y, x]
            if math.isnan(here):
                near_code[y, x], far_code[y, x] = UNSURE, UNSURE
                continue
            while count < depths.shape[0] and depths[count] <= here:
                count += 1
            while count > 0 and depths[count - 1] > here:
                count -= 1
            is_exact = count > 0 and depths[count - 1] == here
            near_code[y, x] = INFINITY if here > depths[-1] else max(count, 1)
            far_code[y, x] = min(count if is_exact else count + 1, INFINITY)


@njit(cache=True, error_model="numpy", nogil=True)
def reduce_patches(
    near_code: Image, far_code: Image, times: int, kinds: Image, sky: int, edge: int, sure_share: float,
    near: Image, far: Image, all_kinds: Image,
) -> None:  # fmt: skip
    """Fill near, far, all_kinds (h, w) from codes and kinds of the pixels of each edge x edge patch, smaller at the border.

    near_code, far_code : (H // times, W // times), each code of times x times pixels; beyond them a pixel is UNSURE
    kinds               : (H, W); `sky` is looked at to infinity, unless its code denies it, when it is UNSURE
    A patch is UNSURE when less than `sure_share` of its pixels are sure.
    """
    column_of = np.arange(kinds.shape[1]) // times
    for y in range(near.shape[0]):
        for x in range(near.shape[1]):
            low, high, bits, sure, count = INFINITY, UNSURE, 0, 0, 0
            for v in range(y * edge, min((y + 1) * edge, kinds.shape[0])):
                row = v // times
                for u in range(x * edge, min((x + 1) * edge, kinds.shape[1])):
                    count += 1
                    bits |= int(kinds[v, u])
                    nearest, furthest, column = UNSURE, UNSURE, column_of[u]
                    if row < near_code.shape[0] and column < near_code.shape[1]:
                        nearest, furthest = int(near_code[row, column]), int(far_code[row, column])
                    if kinds[v, u] == sky:
                        is_denied = nearest not in (UNSURE, INFINITY)
                        nearest, furthest = (UNSURE, UNSURE) if is_denied else (INFINITY, INFINITY)
                    if nearest != UNSURE:
                        sure += 1
                        low, high = min(low, nearest), max(high, furthest)
            is_sure = sure >= sure_share * count
            near[y, x] = low if is_sure else UNSURE
            far[y, x] = high if is_sure else UNSURE
            all_kinds[y, x] = bits
