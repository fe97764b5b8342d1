"""Tiles of an orthophoto: the sharper of two pictures in each pixel, and tiles at half their size."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]


@njit(cache=True, error_model="numpy", nogil=True)
def lay_sharper(colour: Float32, alpha: Float32, sharpness: UInt8, solid: np.float32, tile: UInt8, best: UInt8) -> None:
    """Lay a picture on a tile where it shows and is sharper than what lies there.

    colour     (H, W, C) times its alpha, C = 1 (grey) or 3 (RGB), 0 to 255
    alpha      (H, W); it shows from `solid` on
    sharpness  (H, W) of the picture
    tile, best (H, W, 4) RGBA and (H, W) the sharpness of what lies there; both are changed
    """
    last = colour.shape[2] - 1
    for y in range(tile.shape[0]):
        for x in range(tile.shape[1]):
            if not (alpha[y, x] >= solid and sharpness[y, x] > best[y, x]):
                continue
            for k in range(3):
                shown = np.rint(colour[y, x, min(k, last)] / max(alpha[y, x], solid))
                tile[y, x, k] = np.uint8(min(max(shown, np.float32(0)), np.float32(255)))
            tile[y, x, 3] = 255
            best[y, x] = sharpness[y, x]


@njit(cache=True, error_model="numpy", nogil=True)
def halve_colours(tile: UInt8, half: UInt8) -> None:
    """Fill half (H, W, 4) with the means of 2 x 2 pixels of RGBA (2H, 2W, 4), weighted by alpha, and the mean alpha."""
    for y in range(half.shape[0]):
        for x in range(half.shape[1]):
            total, red, green, blue = 0, 0, 0, 0
            for v in range(2 * y, 2 * y + 2):
                for u in range(2 * x, 2 * x + 2):
                    alpha = int(tile[v, u, 3])
                    total += alpha
                    red += alpha * int(tile[v, u, 0])
                    green += alpha * int(tile[v, u, 1])
                    blue += alpha * int(tile[v, u, 2])
            weight = max(total, 1)
            half[y, x, 0] = np.uint8(np.rint(red / weight))
            half[y, x, 1] = np.uint8(np.rint(green / weight))
            half[y, x, 2] = np.uint8(np.rint(blue / weight))
            half[y, x, 3] = np.uint8(np.rint(0.25 * total))
