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
    for y in range(out.shape[0]):
        is_known = undo_row(raw[y], channels, out[max(y - 1, 0)], y == 0, out[y])
        if not is_known:
            return False
    return True


@bare
def unfilter_to_grey(raw, lines, out):  # type: ignore[no-untyped-def]
    """raw (h, 1 + 3 w) uint8 of RGB, each row's filter before it, to grey levels (h, w) uint8. False where a filter is unknown.

    lines : (2, 3 w) uint8, room for the colours of a row and of that above it
    """
    height = out.shape[0]
    for y in range(height):
        is_above_one_that_reads_it = y + 1 < height and raw[y + 1, 0] > 1
        if raw[y, 0] == 1 and not is_above_one_that_reads_it:
            grey_of_differences(raw[y, 1:], out[y])
            continue
        line = lines[y & 1]
        if not undo_row(raw[y], 3, lines[1 - (y & 1)], y == 0, line):
            return False
        for x in range(out.shape[1]):
            out[y, x] = grey_level(line[3 * x], line[3 * x + 1], line[3 * x + 2])
    return True


@bare
def undo_row(filtered, channels, up, first, row):  # type: ignore[no-untyped-def]
    """A row filtered (1 + w channels), its filter before it, to row (w channels). False where the filter is unknown.

    up : the row above (w channels), which is not read where this is the first
    """
    kind, source = filtered[0], filtered[1:]
    if kind == 0 or (kind == 2 and first):
        for x in range(row.shape[0]):
            row[x] = source[x]
    elif kind == 1 or (kind == 4 and first):  # a pixel above the first row is 0, and Paeth then takes the left one
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
                above = np.int64(u8(0) if first else up[x])
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
def grey_of_differences(source, out):  # type: ignore[no-untyped-def]
    """A row of RGB (3 w) of filter 1 to its grey levels (w)."""
    red, green, blue = u8(0), u8(0), u8(0)
    for x in range(out.shape[0]):
        red, green, blue = u8(red + source[3 * x]), u8(green + source[3 * x + 1]), u8(blue + source[3 * x + 2])
        out[x] = grey_level(red, green, blue)


@bare
def grey_level(red, green, blue):  # type: ignore[no-untyped-def]
    """Of one pixel, 0.299 R + 0.587 G + 0.114 B, rounded down."""
    return u8((RED * np.int32(red) + GREEN * np.int32(green) + BLUE * np.int32(blue)) >> 15)
