"""Pieces of upright things in a label image: runs of one class in bands of rows, and their chains from band to band."""

import numpy as np
from numba import njit


@njit(cache=True)
def runs_in_bands(label, wanted, band, most_px, out):  # type: ignore[no-untyped-def]
    """Runs of a class in bands of rows of label (h, w): first row, first column, column behind the last into out (n, 3).

    A column of a band belongs to the class where more than half of its pixels do. Returns how many there are; runs wider than
    most_px are left out.
    """
    height, width = label.shape
    count = 0
    for v0 in range(0, height - band + 1, band):
        start = -1
        for u in range(width + 1):
            inside = False
            if u < width:
                votes = 0
                for v in range(v0, v0 + band):
                    if label[v, u] == wanted:
                        votes += 1
                inside = 2 * votes > band
            if inside and start < 0:
                start = u
            elif not inside and start >= 0:
                if u - start <= most_px and count < len(out):
                    out[count, 0], out[count, 1], out[count, 2] = v0, start, u
                    count += 1
                start = -1
    return count


@njit(cache=True)
def chain_pieces(band_row, middle, width, disparity, most_gap, chain):  # type: ignore[no-untyped-def]
    """Number of each piece's chain into chain (n,), top down; returns how many chains there are.

    band_row (n,) number of its band, increasing; middle, width (n,) px; disparity (n,) px. A piece goes on the nearest chain that
    stands over it, whose last piece is at most most_gap bands above and has its disparity.
    """
    chains = 0
    last = np.empty(len(chain), np.int64)
    for k in range(len(chain)):
        best, best_off = -1, np.inf
        for c in range(chains):
            j = last[c]
            gap = band_row[k] - band_row[j]
            if gap < 1 or gap > most_gap:
                continue
            aside = abs(middle[k] - middle[j])
            deep = abs(disparity[k] - disparity[j])
            if aside <= 2.0 + 0.5 * max(width[k], width[j]) and deep <= 1.0 + 0.08 * disparity[j] and aside + deep < best_off:
                best, best_off = c, aside + deep
        if best < 0:
            best = chains
            chains += 1
        chain[k] = best
        last[best] = k
    return chains
