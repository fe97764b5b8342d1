"""Inverse PNG row filters (ISO/IEC 15948, 9.2) for one byte a pixel."""

from typing import Any, Final

import numpy as np
from numba import njit

OPTIONS: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "nogil": True, "_nrt": False}
bare = njit(**OPTIONS)
u8 = np.uint8


@bare
def unfilter(raw, out):  # type: ignore[no-untyped-def]
    """raw (h, 1 + w) uint8, each row's filter before it, to out (h, w) uint8. False where a filter is unknown."""
    above = np.int64(0)
    for y in range(out.shape[0]):
        kind, source, row = raw[y, 0], raw[y, 1:], out[y]
        up = out[y - 1] if y else raw[y, 1:]
        if kind == 0 or (kind == 2 and y == 0):
            for x in range(row.shape[0]):
                row[x] = source[x]
        elif kind == 1 or (kind == 4 and y == 0):  # a pixel above the first row is 0, and Paeth then takes the left one
            left = u8(0)
            for x in range(row.shape[0]):
                left = u8(left + source[x])
                row[x] = left
        elif kind == 2:
            for x in range(row.shape[0]):
                row[x] = u8(source[x] + up[x])
        elif kind == 3:
            left = u8(0)
            for x in range(row.shape[0]):
                above = np.int64(up[x] if y else u8(0))
                left = u8(source[x] + u8((np.int64(left) + above) >> 1))
                row[x] = left
        elif kind == 4:
            undo_paeth(source, up, row)
        else:
            return False
    return True


@bare
def undo_paeth(source, up, row):  # type: ignore[no-untyped-def]
    """One row of filter 4: the nearest of left, above and above left to left + above - above left."""
    left, corner = np.int64(0), np.int64(0)
    for x in range(row.shape[0]):
        above = np.int64(up[x])
        a, b, c = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
        nearest = left if a <= b and a <= c else above if b <= c else corner
        left, corner = np.int64(u8(source[x] + u8(nearest))), above
        row[x] = u8(left)
