"""Inverse PNG row filters (ISO/IEC 15948, 9.2) for one byte a channel, and the grey levels of what they leave."""

from typing import Any, Final

import numpy as np
from numba import njit

OPTIONS: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "nogil": True, "_nrt": False}
bare = njit(**OPTIONS)
u8 = np.uint8
RED, GREEN, BLUE = np.int32(9797), np.int32(19234), np.int32(3737)
"""0.299, 0.587 and the rest of 2^15, as libpng's fixed point has them."""


@bare
def unfilter(raw, channels, out):  # type: ignore[no-untyped-def]
    """raw (h, 1 + w channels) uint8, each row's filter before it, to out (h, w channels) uint8. False where a filter is unknown."""
    above = np.int64(0)
    for y in range(out.shape[0]):
        kind, source, row = raw[y, 0], raw[y, 1:], out[y]
        up = out[y - 1] if y else raw[y, 1:]
        if kind == 0 or (kind == 2 and y == 0):
            for x in range(row.shape[0]):
                row[x] = source[x]
        elif kind == 1 or (kind == 4 and y == 0):  # a pixel above the first row is 0, and Paeth then takes the left one
            for channel in range(channels):
                left = u8(0)
                for x in range(channel, row.shape[0], channels):
                    left = u8(left + source[x])
                    row[x] = left
        elif kind == 2:
            for x in range(row.shape[0]):
                row[x] = u8(source[x] + up[x])
        elif kind == 3:
            for channel in range(channels):
                left = u8(0)
                for x in range(channel, row.shape[0], channels):
                    above = np.int64(up[x] if y else u8(0))
                    left = u8(source[x] + u8((np.int64(left) + above) >> 1))
                    row[x] = left
        elif kind == 4:
            for channel in range(channels):
                undo_paeth(source, up, row, channel, channels)
        else:
            return False
    return True


@bare
def undo_paeth(source, up, row, channel, channels):  # type: ignore[no-untyped-def]
    """A channel of one row of filter 4: the nearest of left, above and above left to left + above - above left."""
    left, corner = np.int64(0), np.int64(0)
    for x in range(channel, row.shape[0], channels):
        above = np.int64(up[x])
        a, b, c = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
        nearest = left if a <= b and a <= c else above if b <= c else corner
        left, corner = np.int64(source[x] + u8(nearest)) & 255, above
        row[x] = u8(left)


@bare
def grey_levels(rgb, out):  # type: ignore[no-untyped-def]
    """rgb (h, w, 3) uint8 to out (h, w) uint8."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            weighed = RED * np.int32(rgb[y, x, 0]) + GREEN * np.int32(rgb[y, x, 1]) + BLUE * np.int32(rgb[y, x, 2])
            out[y, x] = u8(weighed >> 15)
