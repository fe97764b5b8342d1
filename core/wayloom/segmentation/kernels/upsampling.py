"""Bilinear upsampling of logits with arg max at full resolution."""

import numpy as np
from numba import njit

_SURE = np.float32(1e-6)
"""Of the largest logit: twice what rounding may take from the lead of one class between two columns of the grid."""


@njit(cache=True, error_model="numpy", nogil=True)
def upsampled_argmax(logits, padded_height, padded_width, height, width):  # type: ignore[no-untyped-def]
    """The class of the largest bilinearly upsampled logit of each pixel; ties go to the lowest class.

    Pixel centres of both grids are aligned by area (`align_corners` false): s = (o + 0.5) * stride - 0.5, clamped to the grid.
    A class that leads in two columns of the grid leads between them, so only pixels between two classes are weighed.

    logits         (gh, gw, C) float32, C contiguous
    padded_height, padded_width  size in pixels of the image that the grid covers
    height, width  of the result: the top-left part of that image
    returns        (height, width) uint8
    """
    grid_height, grid_width, class_count = logits.shape
    labels = np.empty((height, width), np.uint8)
    row = np.empty((grid_width, class_count), np.float32)
    leader = np.empty(grid_width, np.uint8)
    lead = np.empty(grid_width, np.float32)
    scale_v = grid_height / padded_height
    scale_u = grid_width / padded_width
    for v in range(height):
        sv = min(max((v + 0.5) * scale_v - 0.5, 0.0), grid_height - 1.0)
        v0 = int(sv)
        v1 = min(v0 + 1, grid_height - 1)
        av = np.float32(sv - v0)
        for g in range(grid_width):
            for c in range(class_count):
                row[g, c] = logits[v0, g, c] + av * (logits[v1, g, c] - logits[v0, g, c])
        largest = _find_leaders(row, leader, lead)
        for u in range(width):
            su = min(max((u + 0.5) * scale_u - 0.5, 0.0), grid_width - 1.0)
            u0 = int(su)
            u1 = min(u0 + 1, grid_width - 1)
            if leader[u0] == leader[u1] and min(lead[u0], lead[u1]) > _SURE * largest:
                labels[v, u] = leader[u0]
                continue
            au = np.float32(su - u0)
            best = row[u0, 0] + au * (row[u1, 0] - row[u0, 0])
            winner = 0
            for c in range(1, class_count):
                value = row[u0, c] + au * (row[u1, c] - row[u0, c])
                if value > best:
                    best = value
                    winner = c
            labels[v, u] = winner
    return labels


@njit(cache=True, error_model="numpy", nogil=True)
def _find_leaders(row, leader, lead):  # type: ignore[no-untyped-def]
    """Fill in the class of the largest value of each column and by how much it leads; returns the largest magnitude of all.

    row  (gw, C) float32; leader (gw,) uint8, lead (gw,) float32 are filled. NaN leads nowhere.
    """
    grid_width, class_count = row.shape
    largest = np.float32(0.0)
    for g in range(grid_width):
        best = row[g, 0]
        second = np.float32(-np.inf)
        winner = 0
        least = best
        for c in range(1, class_count):
            value = row[g, c]
            if value > best:
                second = best
                best = value
                winner = c
            else:
                second = max(second, value)
            least = min(least, value)
        leader[g] = winner
        lead[g] = best - second
        largest = max(largest, max(abs(best), abs(least)))
    return largest
