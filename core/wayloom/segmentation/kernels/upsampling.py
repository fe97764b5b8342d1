"""Bilinear upsampling of logits with arg max at full resolution."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def upsampled_argmax(logits, padded_height, padded_width, height, width):  # type: ignore[no-untyped-def]
    """The class of the largest bilinearly upsampled logit of each pixel; ties go to the lowest class.

    Pixel centres of both grids are aligned by area (`align_corners` false): s = (o + 0.5) * stride - 0.5, clamped to the grid.

    logits         (gh, gw, C) float32, C contiguous
    padded_height, padded_width  size in pixels of the image that the grid covers
    height, width  of the result: the top-left part of that image
    returns        (height, width) uint8
    """
    grid_height, grid_width, class_count = logits.shape
    labels = np.empty((height, width), np.uint8)
    row = np.empty((grid_width, class_count), np.float32)
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
        for u in range(width):
            su = min(max((u + 0.5) * scale_u - 0.5, 0.0), grid_width - 1.0)
            u0 = int(su)
            u1 = min(u0 + 1, grid_width - 1)
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
