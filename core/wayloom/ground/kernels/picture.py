"""Orthophoto and votes: what one view shows of the surface's cells."""

import numpy as np
from numba import njit

EDGE_PX = 2.0


@njit(cache=True, error_model="numpy", inline="always")
def _seen_at(x, y, z, camera, T_cam_sheet):  # type: ignore[no-untyped-def]
    """u, v, depth of a point of the sheet."""
    T = T_cam_sheet
    depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if depth <= 0.1:
        return -1.0, -1.0, depth
    a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    return camera[0] * a / depth + camera[2], camera[1] * b / depth + camera[3], depth


@njit(cache=True, error_model="numpy", inline="always")
def _sharpness(u, v, depth, camera, T_cam_sheet):  # type: ignore[no-untyped-def]
    """The smaller singular value of d(u, v) / d(x, y) on level ground, px/m."""
    T, fx, fy = T_cam_sheet, camera[0], camera[1]
    x, y = (u - camera[2]) / fx, (v - camera[3]) / fy
    a, b = fx * (T[0, 0] - x * T[2, 0]) / depth, fx * (T[0, 1] - x * T[2, 1]) / depth
    c, d = fy * (T[1, 0] - y * T[2, 0]) / depth, fy * (T[1, 1] - y * T[2, 1]) / depth
    squares, det = a * a + b * b + c * c + d * d, abs(a * d - b * c)
    largest2 = 0.5 * (squares + np.sqrt(max(squares * squares - 4.0 * det * det, 0.0)))
    return det / np.sqrt(largest2)


@njit(cache=True, error_model="numpy", inline="always")
def _hidden(u, v, depth, above, first_row, plane, bf, bias, slack):  # type: ignore[no-untyped-def]
    """Whether the view's own depth contradicts a surface at this depth: by more than `slack` of the camera's height."""
    i, j = int(np.rint(v)) - first_row, int(np.rint(u))
    if i < 0 or np.isnan(above[i, j]):
        return False
    measured = plane[0] * j + plane[1] * (i + first_row) + plane[2] + above[i, j] - bias
    return abs(measured - bf / depth) > slack * bf / depth + 1.0


@njit(cache=True, error_model="numpy", nogil=True)
def add_votes(  # type: ignore[no-untyped-def]
    height, low, cell, window, label, kind_of, above, first_row, plane, camera, bf, bias, T_cam_sheet, reach, slack, votes
):
    """Add 1 / depth (eq. 3 of the paper) to the kind that the view shows of each cell (row, column) of window (4,).

    height  (rows, columns) m, NaN without surface; label (h, w) uint8; kind_of (256,) int8: column of votes, -1 for none
    votes   (rows, columns, kinds) float32
    """
    top, bottom, first, last = window[0], window[1], window[2], window[3]
    for r in range(top, bottom):
        y = low[1] + (r + 0.5) * cell
        for c in range(first, last):
            z = height[r, c]
            if np.isnan(z):
                continue
            u, v, depth = _seen_at(low[0] + (c + 0.5) * cell, y, z, camera, T_cam_sheet)
            if depth > reach or not (0.0 <= u <= label.shape[1] - 1.0 and 0.0 <= v <= label.shape[0] - 1.0):
                continue
            kind = kind_of[label[int(np.rint(v)), int(np.rint(u))]]
            if kind < 0 or _hidden(u, v, depth, above, first_row, plane, bf, bias, slack):
                continue
            votes[r, c, kind] += 1.0 / depth


@njit(cache=True, error_model="numpy", nogil=True)
def add_colours(  # type: ignore[no-untyped-def]
    height,
    low,
    cell,
    window,
    image,
    image_row,
    gain,
    offset,
    fall_off,
    shown,
    above,
    first_row,
    plane,
    camera,
    bf,
    bias,
    T_cam_sheet,
    reach,
    slack,
    power,
    colour,
    weight,
    sharp,
):
    """Add what one view shows of the pixels (2 x 2 a cell) of the cells of window (4,), by sharpness^power.

    image   (h, w, C) uint8 from row `image_row` of the view on; its value in the drive's exposure is (gain * value + offset)
            (1 + r^2)^fall_off, r the tangent of the angle from the axis
    shown   (h, w) float32 0 to 1 of the same rows: how far inside of ground that may be shown; 0 shows nothing
    colour  (2 rows, 2 columns, C), weight, sharp (2 rows, 2 columns) float32: sums
    """
    top, bottom, first, last = window[0], window[1], window[2], window[3]
    rows, columns = height.shape
    half = 0.5 * cell
    channels = image.shape[2]
    edge_v, edge_u = image_row + image.shape[0] - 1.0 - EDGE_PX, image.shape[1] - 1.0 - EDGE_PX
    for r in range(top, bottom):
        for c in range(first, last):
            z = height[r, c]
            if np.isnan(z):
                continue
            east = height[r, min(c + 1, columns - 1)] - z
            west = z - height[r, max(c - 1, 0)]
            north = height[min(r + 1, rows - 1), c] - z
            south = z - height[max(r - 1, 0), c]
            slope_x = 0.5 * (east + west) if abs(east) < half and abs(west) < half else 0.0
            slope_y = 0.5 * (north + south) if abs(north) < half and abs(south) < half else 0.0
            for k in range(4):
                dx, dy = (k % 2) - 0.5, (k // 2) - 0.5
                x, y = low[0] + (c + 0.5 + 0.5 * dx) * cell, low[1] + (r + 0.5 + 0.5 * dy) * cell
                u, v, depth = _seen_at(x, y, z + 0.5 * (dx * slope_x + dy * slope_y), camera, T_cam_sheet)
                if depth > reach or not (EDGE_PX <= u <= edge_u and image_row + EDGE_PX <= v <= edge_v):
                    continue
                inside = shown[int(np.rint(v)) - image_row, int(np.rint(u))]
                if inside <= 0.0 or _hidden(u, v, depth, above, first_row, plane, bf, bias, slack):
                    continue
                sharpness = _sharpness(u, v, depth, camera, T_cam_sheet)
                border = min(min(u, edge_u - u), edge_v - v) / (0.05 * image.shape[1])
                w = inside * min(1.0, 0.02 + border) * sharpness**power
                across, down = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
                lift = (1.0 + across * across + down * down) ** fall_off
                i, j = int(np.floor(v - image_row)), int(np.floor(u))
                fv, fu = v - image_row - i, u - j
                row, column = 2 * r + k // 2, 2 * c + k % 2
                for n in range(channels):
                    value = (1.0 - fv) * ((1.0 - fu) * image[i, j, n] + fu * image[i, j + 1, n]) + fv * (
                        (1.0 - fu) * image[i + 1, j, n] + fu * image[i + 1, j + 1, n]
                    )
                    colour[row, column, n] += w * lift * (gain * value + offset)
                weight[row, column] += w
                sharp[row, column] += w * sharpness
