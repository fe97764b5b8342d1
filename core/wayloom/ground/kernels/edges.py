"""Photo-consistency of steps along the border of the road: one view's pair of images against a road plane with a raised side.

A ray that meets the road plane at a0 across the border meets what lies z over it at a0 - k z, k = (a0 - a_C) / h_C, with the camera
at a_C and h_C over the plane. So with a step of height h at s it sees z = clip((a0 - s) / k, 0, h): road, face, or upper side.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

LEAST_SLANT = 0.05
"""Of k: seen more steeply, or from the upper side, a step shows no face."""


@njit(cache=True, error_model="numpy", inline="always")
def _at(image, i, v, u):  # type: ignore[no-untyped-def]
    """Bilinear value of image (2, h, w), number i, at row v and column u, which are inside."""
    r, c = int(v), int(u)
    fv, fu = v - r, u - c
    upper = (1.0 - fu) * image[i, r, c] + fu * image[i, r, c + 1]
    lower = (1.0 - fu) * image[i, r + 1, c] + fu * image[i, r + 1, c + 1]
    return (1.0 - fv) * upper + fv * lower


@njit(cache=True, error_model="numpy", nogil=True)
def _differences(  # type: ignore[no-untyped-def]
    place, along, across, rises, pair, first_row, usable, camera, bf, bias, T_cam_sheet, eye, reach, most, table
):
    """Fill table (A, Z): summed differences of left and right at what is `across` (A,) the border and `rises` (Z,) over the plane.

    place : (7,) x, y, the normal away from the road, and the plane's height, slope across and slope along at a station
    Returns the camera's place across the border and its height over the plane, and how much was seen.
    """
    x0, y0, nx, ny, z0, slope_a, slope_b = place
    eye_a = (eye[0] - x0) * nx + (eye[1] - y0) * ny
    eye_b = -(eye[0] - x0) * ny + (eye[1] - y0) * nx
    over = eye[2] - (z0 + slope_a * eye_a + slope_b * eye_b)
    nearer = 1.0 - rises / over
    T, seen = T_cam_sheet, 0.0
    rows, columns = usable.shape
    table[:] = 0.0
    for n in range(across.shape[0]):
        for m in range(along.shape[0]):
            a, b = across[n], along[m]
            x, y, z = x0 + a * nx - b * ny, y0 + a * ny + b * nx, z0 + slope_a * a + slope_b * b
            depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            if depth < 1.0 or depth > reach:
                continue
            u = camera[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth + camera[2]
            v = camera[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth + camera[3] - first_row
            farthest = u - bf / (depth * nearer[-1]) - bias
            if v < 0.0 or v >= rows - 1.0 or farthest < 0.0 or u >= columns - 1.0:
                continue
            if not usable[int(np.rint(v)), int(np.rint(u))]:
                continue
            left = _at(pair, 0, v, u)
            # image pixels that show a sample: fx fy h / depth^3 a square metre
            weight = min(1.0, camera[0] * camera[1] * over * (along[1] - along[0]) * (across[1] - across[0]) / depth**3)
            for k in range(rises.shape[0]):
                right = _at(pair, 1, v, u - bf / (depth * nearer[k]) - bias)
                table[n, k] += weight * min(abs(left - right), most)
            seen += weight
    return eye_a, over, seen


@njit(cache=True, error_model="numpy", inline="always")
def _between(row: Float64, z: float, step: float) -> float:
    """Linear value of row (Z,), whose entries are `step` apart, at z from 0 to the last one."""
    level = min(int(z / step), row.shape[0] - 2)
    share = z / step - level
    return float((1.0 - share) * row[level] + share * row[level + 1])


@njit(cache=True, error_model="numpy", nogil=True)
def _add_steps(
    table: Float64, upper: Float64, across: Float64, rises: Float64, shifts: Float64, eye_a: float, over: float, totals: Float64,
    out: Float64,
) -> None:  # fmt: skip
    """Add to out (K, Z) the differences that steps of heights `rises` (Z,) at shifts (K,) see in table (A, Z).

    upper (A, Z), totals (Z,) : room to work in
    """
    step, heights = rises[1] - rises[0], rises.shape[0]
    for n in range(across.shape[0]):
        for h in range(heights):
            upper[n, h] = _between(table[n], rises[h], step)
    for k in range(shifts.shape[0]):
        totals[:] = 0.0
        for n in range(across.shape[0]):
            slant = (across[n] - eye_a) / over
            if slant > LEAST_SLANT:
                z = max((across[n] - shifts[k]) / slant, 0.0)
                face = _between(table[n], min(z, rises[-1]), step)
                for h in range(heights):
                    totals[h] += face if z < rises[h] else upper[n, h]
            else:
                for h in range(heights):
                    totals[h] += upper[n, h] if across[n] - slant * rises[h] > shifts[k] else upper[n, 0]
        for h in range(heights):
            out[k, h] += totals[h]


@njit(cache=True, error_model="numpy", nogil=True)
def add_step_costs(  # type: ignore[no-untyped-def]
    places, along, across, rises, shifts, pair, first_row, usable, camera, bf, bias, T_cam_sheet, eye, reach, most, costs, seen
):
    """Add what one view says of steps at each station.

    places  (S, 7) x, y, normal (2) away from the road, height m, slopes across and along of the road's plane there; NaN: none
    along, across (B,), (A,) m: samples around a station, evenly spaced; rises (Z,) m from 0 on, evenly spaced: heights of steps
    shifts  (K,) m: places of steps across the border
    pair    (2, h, w) float32 left and right rows from first_row on, without their local means; usable (h, w) bool of the left one
    eye     (3,) the camera in the sheet's frame; most: largest difference of two grey values
    costs   (S, K, Z) float64 sums of differences; seen (S,) float64 sums of weights: image pixels
    """
    table, upper = np.empty((across.shape[0], rises.shape[0])), np.empty((across.shape[0], rises.shape[0]))
    totals = np.empty(rises.shape[0])
    for s in range(places.shape[0]):
        if np.isnan(places[s, 4]):
            continue
        dx, dy = places[s, 0] - eye[0], places[s, 1] - eye[1]
        if dx * dx + dy * dy > reach * reach:
            continue
        eye_a, over, pixels = _differences(
            places[s], along, across, rises, pair, first_row, usable, camera, bf, bias, T_cam_sheet, eye, reach, most, table
        )
        if pixels <= 0.0:
            continue
        seen[s] += pixels
        _add_steps(table, upper, across, rises, shifts, eye_a, over, totals, costs[s])


@njit(cache=True, error_model="numpy", nogil=True)
def side_planes(  # type: ignore[no-untyped-def]
    stations, height, information, group, of, cell, low, window, flat, step, rounds, least, out, count
):
    """Robust planes over the cells of one group beside each station: out (S, 3) height at the station m, slopes across and along.

    stations (S, 5) x, y, normal (2), and the place across from which the sides are told; height, information, group (H, W)
    window   (3,) m: across from, across to, half along; signed: negative across is the road
    flat     weight, in cells, by which slopes are held to zero; step m: scale of the weights of Cauchy
    NaN with fewer than `least` cells; count (S,) int32 of them
    """
    rows, columns = height.shape
    near, far, half = window
    radius = int(np.ceil(np.hypot(max(abs(near), abs(far)), half) / cell)) + 1
    for s in range(stations.shape[0]):
        out[s] = np.nan
        x0, y0, nx, ny, at = stations[s]
        if np.isnan(at):
            continue
        x0, y0 = x0 + at * nx, y0 + at * ny
        j0, i0 = int(np.floor((x0 - low[0]) / cell)), int(np.floor((y0 - low[1]) / cell))
        p = np.zeros(3)
        scale = 4.0 * step
        for n in range(rounds):
            A, b, total = np.zeros((3, 3)), np.zeros(3), 0
            for i in range(max(i0 - radius, 0), min(i0 + radius + 1, rows)):
                for j in range(max(j0 - radius, 0), min(j0 + radius + 1, columns)):
                    if information[i, j] <= 0.0 or group[i, j] != of:
                        continue
                    dx, dy = low[0] + (j + 0.5) * cell - x0, low[1] + (i + 0.5) * cell - y0
                    a, c = dx * nx + dy * ny, -dx * ny + dy * nx
                    if a < near or a > far or abs(c) > half:
                        continue
                    rest = (height[i, j] - p[0] - p[1] * a - p[2] * c) / scale if n > 0 else 0.0
                    w = min(information[i, j], 1e4) / (1.0 + rest * rest)
                    total += 1
                    A[0, 0] += w
                    A[0, 1] += w * a
                    A[0, 2] += w * c
                    A[1, 1] += w * a * a
                    A[1, 2] += w * a * c
                    A[2, 2] += w * c * c
                    b[0] += w * height[i, j]
                    b[1] += w * a * height[i, j]
                    b[2] += w * c * height[i, j]
            if total < least:
                break
            scale = max(0.5 * scale, step)
            A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
            A[1, 1] += flat * A[0, 0] / total
            A[2, 2] += flat * A[0, 0] / total
            p[:] = np.linalg.solve(A, b)
        count[s] = total
        if total >= least:
            out[s] = p


@njit(cache=True, error_model="numpy", nogil=True)
def nearest_steps(stations, cell, low, across, along, nearest, distance2):  # type: ignore[no-untyped-def]
    """Of each cell (H, W) the number of the station (S, 5), as `side_planes` has them, whose step is nearest, -1 for none.

    A station's cells are within `across` m of its step and `along` m of its place. distance2 (H, W) m^2 is inf before.
    """
    rows, columns = nearest.shape
    radius = int(np.ceil(np.hypot(across, along) / cell)) + 1
    for s in range(stations.shape[0]):
        x0, y0, nx, ny, at = stations[s]
        if np.isnan(at):
            continue
        x0, y0 = x0 + at * nx, y0 + at * ny
        j0, i0 = int(np.floor((x0 - low[0]) / cell)), int(np.floor((y0 - low[1]) / cell))
        for i in range(max(i0 - radius, 0), min(i0 + radius + 1, rows)):
            for j in range(max(j0 - radius, 0), min(j0 + radius + 1, columns)):
                dx, dy = low[0] + (j + 0.5) * cell - x0, low[1] + (i + 0.5) * cell - y0
                if abs(dx * nx + dy * ny) > across or abs(dy * nx - dx * ny) > along:
                    continue
                if dx * dx + dy * dy < distance2[i, j]:
                    distance2[i, j], nearest[i, j] = dx * dx + dy * dy, s
