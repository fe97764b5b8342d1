"""Bilinear upsampling of logits with arg max at full resolution."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]
Corners = tuple[Float32, Float32, Float32, Float32]
"""(C,) logits each of four cells: above left, above right, below left, below right."""

_ROUNDING = np.float32(2e-6)
"""Of the largest logit: more than rounding takes from the lead of one class over another between four cells of the grid."""


@njit(cache=True, error_model="numpy", nogil=True)
def upsampled_argmax(logits, padded_height, padded_width, height, width):  # type: ignore[no-untyped-def]
    """The class of the largest bilinearly upsampled logit of each pixel; ties go to the lowest class.

    Pixel centres of both grids are aligned by area (`align_corners` false): s = (o + 0.5) * stride - 0.5, clamped to the grid.
    A class that leads in four neighbouring cells leads between them; elsewhere only those are weighed that may lead.

    logits         (gh, gw, C) float32, C contiguous
    padded_height, padded_width  size in pixels of the image that the grid covers
    height, width  of the result: the top-left part of that image
    returns        (height, width) uint8
    """
    grid_height, grid_width, class_count = logits.shape
    labels = np.empty((height, width), np.uint8)
    leader, lead, largest = _leaders(logits)
    above, share_v = _places(grid_height, padded_height, height)
    left, share_u = _places(grid_width, padded_width, width)
    some = np.empty(class_count, np.int64)
    start_v = 0
    while start_v < height:
        v0, end_v = above[start_v], _end_of_run(above, start_v)
        v1 = min(v0 + 1, grid_height - 1)
        start_u = 0
        while start_u < width:
            u0, end_u = left[start_u], _end_of_run(left, start_u)
            u1 = min(u0 + 1, grid_width - 1)
            winner = leader[v0, u0]
            least = min(min(lead[v0, u0], lead[v0, u1]), min(lead[v1, u0], lead[v1, u1]))
            alike = winner == leader[v0, u1] and winner == leader[v1, u0] and winner == leader[v1, u1]
            if alike and least > _ROUNDING * largest:
                labels[start_v:end_v, start_u:end_u] = winner
            else:
                corners = (logits[v0, u0], logits[v0, u1], logits[v1, u0], logits[v1, u1])
                count = class_count if least < 0 else _find_contenders(corners, _ROUNDING * largest, some)
                if count == class_count:
                    some[:] = np.arange(class_count)
                for v in range(start_v, end_v):
                    for u in range(start_u, end_u):
                        labels[v, u] = _winner(corners, share_v[v], share_u[u], some[:count])
            start_u = end_u
        start_v = end_v
    return labels


@njit(cache=True, error_model="numpy", nogil=True)
def _places(cells: int, padded: int, pixels: int) -> tuple[Int64, Float32]:
    """Along one axis: (pixels,) int64 last cell before each pixel, (pixels,) float32 how far it is on the way to the next."""
    before = np.empty(pixels, np.int64)
    share = np.empty(pixels, np.float32)
    for o in range(pixels):
        s = min(max((o + 0.5) * (cells / padded) - 0.5, 0.0), cells - 1.0)
        before[o] = int(s)
        share[o] = np.float32(s - before[o])
    return before, share


@njit(cache=True, error_model="numpy", nogil=True)
def _end_of_run(values: Int64, start: int) -> int:
    """Behind the last of the equal values from `start` on."""
    end = start + 1
    while end < len(values) and values[end] == values[start]:
        end += 1
    return end


@njit(cache=True, error_model="numpy", nogil=True)
def _leaders(logits: Float32) -> tuple[NDArray[np.uint8], Float32, np.float32]:
    """Of each cell's (gh, gw, C) logits the class of the largest (gh, gw) uint8 and by how much it leads (gh, gw) float32.

    The third is the largest magnitude of all. The lead is -1 where a logit is not finite.
    """
    grid_height, grid_width, class_count = logits.shape
    leader = np.empty((grid_height, grid_width), np.uint8)
    lead = np.empty((grid_height, grid_width), np.float32)
    largest = np.float32(0.0)
    for v in range(grid_height):
        for u in range(grid_width):
            best = logits[v, u, 0]
            second = np.float32(-np.inf)
            least = best
            total = best
            winner = 0
            for c in range(1, class_count):
                value = logits[v, u, c]
                total += value
                if value > best:
                    second = best
                    best = value
                    winner = c
                else:
                    second = max(second, value)
                least = min(least, value)
            leader[v, u] = winner
            lead[v, u] = best - second if total - total == 0 else np.float32(-1.0)
            largest = max(largest, max(abs(best), abs(least)))
    return leader, lead, largest


@njit(cache=True, error_model="numpy", nogil=True)
def _find_contenders(corners: Corners, rounding: np.float32, some: Int64) -> int:
    """Fill in the classes that may lead somewhere between four cells, in order, and return their number.

    Some class nowhere falls below the largest of all classes' least values: whose largest value does cannot lead.
    """
    a, b, c, d = corners
    bound = np.float32(-np.inf)
    for k in range(len(a)):
        bound = max(bound, min(min(a[k], b[k]), min(c[k], d[k])))
    count = 0
    for k in range(len(a)):
        if max(max(a[k], b[k]), max(c[k], d[k])) >= bound - rounding:
            some[count] = k
            count += 1
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def _winner(corners: Corners, share_v: np.float32, share_u: np.float32, classes: Int64) -> int:
    """The first of `classes` whose value between four cells is largest."""
    a, b, c, d = corners
    best = np.float32(0.0)
    winner = -1
    for k in classes:
        left = a[k] + share_v * (c[k] - a[k])
        right = b[k] + share_v * (d[k] - b[k])
        value = left + share_u * (right - left)
        if winner < 0 or value > best:
            best = value
            winner = k
    return winner
