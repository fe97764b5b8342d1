"""Point selection: pixels of high gradient, spread over the image, none where a point already is."""

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, kernel

f32 = np.float32
TAKEN_CELL = 8
"""px, of the mask of places that already hold a point."""


@inlined
def fill_peaks(size, first, last, peaks, rows):  # type: ignore[no-untyped-def]
    """The largest gradient of each column from row first to last - 1, and the first row that has it, into (w,) peaks and rows."""
    w = size.shape[1]
    for x in range(w):
        peaks[x], rows[x] = size[first, x], first
    for y in range(first + 1, last):
        row, here = size[y], np.int32(y)
        for x in range(w):
            g, peak, place = row[x], peaks[x], rows[x]
            peaks[x], rows[x] = (g if g > peak else peak), (here if g > peak else place)


@inlined
def strongest(peaks, x0, x1):  # type: ignore[no-untyped-def]
    """The largest of peaks[x0:x1], without a branch."""
    peak = f32(0)
    for x in range(x0, x1):
        peak = max(peak, peaks[x])
    return peak


@inlined
def scan_cell(peaks, rows, thresholds, block, x0, x1, best):  # type: ignore[no-untyped-def]
    """Strongest pixels of a cell's columns within one row of blocks, of thresholds (w/block,): best (3, 3) has rows x, y, gradient
    of those above 1, 3/4 and 1/2 of the threshold, updated; of equal ones the first in the order of rows stays. Of the columns
    within one block only the strongest can be one of them."""
    first, second, third = best[0, 2], best[1, 2], best[2, 2]
    new1, new2, new3 = False, False, False
    start = x0
    while start < x1:
        threshold, end = np.float64(thresholds[start // block]), min(x1, (start // block + 1) * block)
        peak = strongest(peaks, start, end)
        g = np.float64(peak)
        if g > 0.5 * threshold:
            x = start
            while peaks[x] != peak:
                x += 1
            for other in range(x + 1, end):
                if peaks[other] == peak and rows[other] < rows[x]:
                    x = other
            y = rows[x]
            if g > third or (new3 and g == third and y < best[2, 1]):
                best[2, 0], best[2, 1], third, new3 = x, y, g, True
            if g > 0.75 * threshold and (g > second or (new2 and g == second and y < best[1, 1])):
                best[1, 0], best[1, 1], second, new2 = x, y, g, True
            if g > threshold and (g > first or (new1 and g == first and y < best[0, 1])):
                best[0, 0], best[0, 1], first, new1 = x, y, g, True
        start = end
    best[0, 2], best[1, 2], best[2, 2] = first, second, third


@inlined
def append(u, v, taken, points, n):  # type: ignore[no-untyped-def]
    """Put (u, v) at points[n] unless the place is taken or points is full; returns the new n."""
    if n < points.shape[0] and not taken[v // TAKEN_CELL, u // TAKEN_CELL]:
        points[n, 0], points[n, 1] = u, v
        return n + 1
    return n


def select_pixels(size, thresholds, block, cell, border, taken, points):  # type: ignore[no-untyped-def]
    """The strongest pixel of each cell of `cell` px above its block's threshold; where a 2x2 group of cells has none, one at 3/4 of
    the threshold; where a 4x4 group has none, one at 1/2 (after Engel et al. 2018, sec. 3.2).

    size (h, w) float32 gradient; thresholds (h/block, w/block); taken (h/8 + 1, w/8 + 1) bool; fills points (capacity, 2) int64
    with (u, v) and returns their number.
    """
    strips = cell // block + 2
    peaks, rows = np.empty((4, strips, size.shape[1]), np.float32), np.empty((4, strips, size.shape[1]), np.int32)
    return scan_cells(size, thresholds, block, cell, border, taken, peaks, rows, np.zeros((3, 3)), points)


@kernel
def scan_cells(size, thresholds, block, cell, border, taken, peaks, rows, best, points):  # type: ignore[no-untyped-def]
    """select_pixels; peaks and rows (4, strips, w) are working space for four rows of cells, each in strips within one row of
    blocks, best (3, 3) that of scan_cell. A column's peak is found once, by vectors over the image's width."""
    h, w, n = size.shape[0] - border, size.shape[1] - border, 0
    for y4 in range(border, h, 4 * cell):
        for r in range(4):
            top, low = y4 + r * cell, min(y4 + (r + 1) * cell, h)
            if top >= low:
                break
            for first in range(top - top % block, low, block):
                strip = (first - top + top % block) // block
                fill_peaks(size, max(first, top), min(first + block, low), peaks[r, strip], rows[r, strip])
        for x4 in range(border, w, 4 * cell):
            best[2, 2], found4 = 0.0, False
            for y2 in range(y4, min(y4 + 4 * cell, h), 2 * cell):
                for x2 in range(x4, min(x4 + 4 * cell, w), 2 * cell):
                    best[1, 2], found2 = 0.0, False
                    for y1 in range(y2, min(y2 + 2 * cell, h), cell):
                        r, low = (y1 - y4) // cell, min(y1 + cell, h)
                        for x1 in range(x2, min(x2 + 2 * cell, w), cell):
                            best[0, 2] = 0.0
                            for strip in range((low - 1) // block - y1 // block + 1):
                                thresholds_here = thresholds[y1 // block + strip]
                                scan_cell(peaks[r, strip], rows[r, strip], thresholds_here, block, x1, min(x1 + cell, w), best)
                            if best[0, 2] > 0.0:
                                found2 = found4 = True
                                n = append(int(best[0, 0]), int(best[0, 1]), taken, points, n)
                    if not found2 and best[1, 2] > 0.0:
                        found4 = True
                        n = append(int(best[1, 0]), int(best[1, 1]), taken, points, n)
            if not found4 and best[2, 2] > 0.0:
                n = append(int(best[2, 0]), int(best[2, 1]), taken, points, n)
    return n
