"""Patches of a depth image: nearest and furthest code, and kinds."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@njit(cache=True, error_model="numpy", nogil=True)
def reduce_patches(
    near_code: Image, far_code: Image, kinds: Image, edge: int, sure_share: float, near: Image, far: Image, all_kinds: Image
) -> None:
    """Fill near, far, all_kinds (h, w) from codes and kinds (H, W) of the pixels of each edge x edge patch, smaller at the border.

    A pixel with the code 0 is not sure. A patch is 0 when less than `sure_share` of its pixels are sure.
    """
    for y in range(near.shape[0]):
        for x in range(near.shape[1]):
            low, high, bits, sure, count = 255, 0, 0, 0, 0
            for v in range(y * edge, min((y + 1) * edge, near_code.shape[0])):
                for u in range(x * edge, min((x + 1) * edge, near_code.shape[1])):
                    count += 1
                    bits |= int(kinds[v, u])
                    if near_code[v, u] != 0:
                        sure += 1
                        low = min(low, int(near_code[v, u]))
                        high = max(high, int(far_code[v, u]))
            is_sure = sure >= sure_share * count
            near[y, x] = low if is_sure else 0
            far[y, x] = high if is_sure else 0
            all_kinds[y, x] = bits
