"""Point selection: pixels of high gradient, spread over the image, none where a point already is."""

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, kernel

TAKEN_CELL = 8
"""px, of the mask of places that already hold a point."""


@inlined
def scan_cell(size, bits, peak, peak_bits, thresholds, blocks, block, x0, x1, y0, y1, best):  # type: ignore[no-untyped-def]
    """Strongest pixels of a cell: best (3, 3) has rows x, y, gradient of those above 1, 3/4 and 1/2 of the threshold, updated.

    A run of pixels that holds nothing new is passed over by its largest gradient. That is found by the numbers' bits, which are in
    order as the numbers are: a maximum of integers runs on vectors. bits (h, w) int32 are those of size, peak and peak_bits one
    number as both; blocks (n,) the block of each row or column.
    """
    first, second, third = best[0, 2], best[1, 2], best[2, 2]
    for y in range(y0, y1):
        start = x0
        while start < x1:  # one block's columns at a time: they share a threshold
            column = blocks[start]
            end = min(x1, (column + 1) * block)
            threshold = np.float64(thresholds[blocks[y], column])
            most = np.int32(0)
            for x in range(start, end):
                most = max(most, bits[y, x])
            peak_bits[0] = most
            highest = np.float64(peak[0])
            if (
                highest <= max(third, 0.5 * threshold)
                and highest <= max(second, 0.75 * threshold)
                and highest <= max(first, threshold)
            ):
                start = end
                continue
            for x in range(start, end):
                g = np.float64(size[y, x])
                if g > third and g > 0.5 * threshold:
                    best[2, 0], best[2, 1], third = x, y, g
                if g > second and g > 0.75 * threshold:
                    best[1, 0], best[1, 1], second = x, y, g
                if g > first and g > threshold:
                    best[0, 0], best[0, 1], first = x, y, g
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
    blocks, peak = np.arange(max(size.shape)) // block, np.zeros(1, np.float32)
    best, bits, peak_bits = np.zeros((3, 3)), size.view(np.int32), peak.view(np.int32)
    return scan_cells(size, bits, peak, peak_bits, thresholds, blocks, block, cell, border, taken, best, points)


@kernel
def scan_cells(  # type: ignore[no-untyped-def]
    size, bits, peak, peak_bits, thresholds, blocks, block, cell, border, taken, best, points
):
    """select_pixels with what scan_cell asks for."""
    h, w, n = size.shape[0] - border, size.shape[1] - border, 0
    for y4 in range(border, h, 4 * cell):
        for x4 in range(border, w, 4 * cell):
            best[2, 2], found4 = 0.0, False
            for y2 in range(y4, min(y4 + 4 * cell, h), 2 * cell):
                for x2 in range(x4, min(x4 + 4 * cell, w), 2 * cell):
                    best[1, 2], found2 = 0.0, False
                    for y1 in range(y2, min(y2 + 2 * cell, h), cell):
                        for x1 in range(x2, min(x2 + 2 * cell, w), cell):
                            best[0, 2] = 0.0
                            right, low = min(x1 + cell, w), min(y1 + cell, h)
                            scan_cell(size, bits, peak, peak_bits, thresholds, blocks, block, x1, right, y1, low, best)
                            if best[0, 2] > 0.0:
                                found2 = found4 = True
                                n = append(int(best[0, 0]), int(best[0, 1]), taken, points, n)
                    if not found2 and best[1, 2] > 0.0:
                        found4 = True
                        n = append(int(best[1, 0]), int(best[1, 1]), taken, points, n)
            if not found4 and best[2, 2] > 0.0:
                n = append(int(best[2, 0]), int(best[2, 1]), taken, points, n)
    return n
