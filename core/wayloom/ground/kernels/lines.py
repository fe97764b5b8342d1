"""Bright lines in a picture of the ground: contrast against both sides by direction, groups of like direction, mean profiles."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Int32 = NDArray[np.int32]


@njit(cache=True, error_model="numpy", nogil=True)
def side_contrast(
    smooth: Float32, seen: UInt8, candidate: UInt8, normals: Float64, offsets: Float64, dark: float, out: Float32
) -> None:
    """Fill out (K, R, C), zeros: how much brighter a pixel is than the brighter of two places across it, as a share of that one.

    smooth, seen, candidate  (R, C)
    normals                  (K, 2) unit steps (column, row) across a line
    offsets                  (D,) pixels to either side; the offset with the most contrast counts
    dark                     added to the share's denominator
    Where a pixel is no candidate, or one of its sides was not seen, nothing is claimed: 0 stays. Never below 0.
    """
    rows, columns = smooth.shape
    steps = np.empty((normals.shape[0], offsets.shape[0], 2), np.int64)
    for k in range(normals.shape[0]):
        for d in range(offsets.shape[0]):
            steps[k, d, 0], steps[k, d, 1] = round(offsets[d] * normals[k, 0]), round(offsets[d] * normals[k, 1])
    for y in range(rows):
        for x in range(columns):
            if candidate[y, x] == 0:
                continue
            for k in range(normals.shape[0]):
                best = 0.0
                for d in range(offsets.shape[0]):
                    dx, dy = steps[k, d, 0], steps[k, d, 1]
                    if x < abs(dx) or y < abs(dy) or x + abs(dx) >= columns or y + abs(dy) >= rows:
                        continue
                    if seen[y + dy, x + dx] == 0 or seen[y - dy, x - dx] == 0:
                        continue
                    side = max(smooth[y + dy, x + dx], smooth[y - dy, x - dx])
                    best = max(best, (smooth[y, x] - side) / (side + dark))
                out[k, y, x] = best


@njit(cache=True, error_model="numpy", nogil=True)
def along_mean(contrast: Float32, candidate: UInt8, normals: Float64, half: int, best: Float32, angle: Float32) -> None:
    """Fill best, angle (R, C) from contrast (K, R, C): its largest mean along a line, and the direction across the line.

    The mean is of 2 half + 1 places a pixel apart, at right angles to normals (K, 2). angle is that of the doubled-angle mean of
    all directions, weighted by the squares, rad in (-pi/2, pi/2]; both are 0 where candidate (R, C) is.
    """
    count, rows, columns = contrast.shape
    steps = np.empty((count, 2 * half + 1, 2), np.int64)
    for k in range(count):
        for t in range(-half, half + 1):
            steps[k, t + half, 0], steps[k, t + half, 1] = -round(t * normals[k, 1]), round(t * normals[k, 0])
    for y in range(rows):
        for x in range(columns):
            best[y, x], angle[y, x] = 0.0, 0.0
            if candidate[y, x] == 0:
                continue
            most, c2, s2 = 0.0, 0.0, 0.0
            for k in range(count):
                total = 0.0
                for t in range(2 * half + 1):
                    u, v = x + steps[k, t, 0], y + steps[k, t, 1]
                    if 0 <= u < columns and 0 <= v < rows:
                        total += contrast[k, v, u]
                mean = total / (2 * half + 1)
                most = max(most, mean)
                nx, ny = normals[k, 0], normals[k, 1]
                c2 += mean * mean * (nx * nx - ny * ny)
                s2 += mean * mean * 2 * nx * ny
            best[y, x] = most
            if most > 0:
                angle[y, x] = 0.5 * math.atan2(s2, c2)


@njit(cache=True, error_model="numpy", nogil=True)
def like_directions(best: Float32, angle: Float32, low: float, most_rad: float, group: Int32, stack: Int32) -> int:
    """Fill group (R, C) with numbers from 1 on of the connected pixels over low; how many there are.

    Neighbours (8) are connected where their directions differ by at most most_rad (directions, not headings: modulo pi).
    stack (R * C,) is scratch. Groups are numbered by their first pixel in reading order; 0 is none.
    """
    rows, columns = best.shape
    for y in range(rows):
        for x in range(columns):
            group[y, x] = 0
    count = 0
    for y0 in range(rows):
        for x0 in range(columns):
            if best[y0, x0] <= low or group[y0, x0] != 0:
                continue
            count += 1
            group[y0, x0] = count
            stack[0] = y0 * columns + x0
            size = 1
            while size > 0:
                size -= 1
                y, x = stack[size] // columns, stack[size] % columns
                for v in range(max(0, y - 1), min(rows, y + 2)):
                    for u in range(max(0, x - 1), min(columns, x + 2)):
                        if group[v, u] != 0 or best[v, u] <= low:
                            continue
                        turn = abs(angle[v, u] - angle[y, x])
                        if min(turn, math.pi - turn) <= most_rad:
                            group[v, u] = count
                            stack[size] = v * columns + u
                            size += 1
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def mean_profiles(picture: Float32, seen: UInt8, places: Float64, across: Float64, steps: Float64, out: Float64) -> None:
    """Fill out (S, T) with the mean over M places of the picture (R, C) at steps (T,) pixels across.

    places : (S, M, 2) column and row, pixels
    across : (2,) unit step (column, row)
    Between pixels values are bilinear; a value one of whose four pixels is not seen does not count.
    NaN where less than half counts.
    """
    rows, columns = picture.shape
    for s in range(places.shape[0]):
        for t in range(steps.shape[0]):
            total, count = 0.0, 0
            for m in range(places.shape[1]):
                u, v = places[s, m, 0] + steps[t] * across[0], places[s, m, 1] + steps[t] * across[1]
                x, y = math.floor(u), math.floor(v)
                if x < 0 or y < 0 or x + 1 >= columns or y + 1 >= rows:
                    continue
                if seen[y, x] == 0 or seen[y, x + 1] == 0 or seen[y + 1, x] == 0 or seen[y + 1, x + 1] == 0:
                    continue
                a, b = u - x, v - y
                top = (1 - a) * picture[y, x] + a * picture[y, x + 1]
                bottom = (1 - a) * picture[y + 1, x] + a * picture[y + 1, x + 1]
                total += (1 - b) * top + b * bottom
                count += 1
            out[s, t] = total / count if 2 * count > places.shape[1] else np.nan


@njit(cache=True, error_model="numpy", nogil=True)
def band_edges(
    profiles: Float64, steps: Float64, half: float, dark: float, middle: Float64, width: Float64, contrast: Float64, flank: Float64
) -> None:
    """Fill middle, width, contrast, flank (S,) of the bright bands, about half px to both sides of 0, in profiles (S, T).

    steps (T,) are the places of a profile's values, px.
    Edges lie where a profile crosses the height half-way between the band (the 0.85 quantile of its inner part) and the road on
    that side (mean from half + 2 to half + 7 px). contrast is against the brighter side, as a share of it (+ dark). flank is how
    much darker the road close by (half + 1 to half + 3) is than further off (half + 6 to half + 11), on the side where it is less.
    NaN where the core, or both sides, or an edge is not seen; a side that is not seen counts as the other.
    """
    step = steps[1] - steps[0]
    core_half = max(half, 1.0)
    core = np.empty(steps.shape[0])
    for k in range(profiles.shape[0]):
        middle[k], width[k], contrast[k], flank[k] = np.nan, np.nan, np.nan, np.nan
        count, top, known = 0, -1, True
        for t in range(steps.shape[0]):
            if abs(steps[t]) <= core_half:
                known = known and not math.isnan(profiles[k, t])
                if top < 0 or profiles[k, t] > profiles[k, top]:
                    top = t
                if abs(steps[t]) <= max(0.6 * half, 0.5):
                    core[count] = profiles[k, t]
                    count += 1
        left, right = side_mean(profiles[k], steps, -1, half + 2, half + 7), side_mean(profiles[k], steps, 1, half + 2, half + 7)
        if not known or (math.isnan(left) and math.isnan(right)):
            continue
        left = right if math.isnan(left) else left
        right = left if math.isnan(right) else right
        peak = np.sort(core[:count])[int(0.85 * (count - 1))]
        base = max(left, right)
        contrast[k] = (peak - base) / (base + dark)
        low, high = crossing(profiles[k], top, -1, (peak + left) / 2), crossing(profiles[k], top, 1, (peak + right) / 2)
        middle[k], width[k] = steps[0] + step * (low + high) / 2, step * (high - low)
        least = 1e9
        for way in (-1, 1):
            darker = side_mean(profiles[k], steps, way, half + 6, half + 11) - side_mean(
                profiles[k], steps, way, half + 1, half + 3
            )
            least = min(least, 0.0 if math.isnan(darker) else darker)
        flank[k] = least


@njit(cache=True, error_model="numpy", nogil=True)
def side_mean(profile: Float64, steps: Float64, way: int, near: float, far: float) -> float:
    """Mean of the known values between near and far px on one side (way -1 or 1); NaN without any."""
    total, count = 0.0, 0
    for t in range(steps.shape[0]):
        if near < steps[t] * way < far and not math.isnan(profile[t]):
            total += profile[t]
            count += 1
    return total / count if count > 0 else math.nan


@njit(cache=True, error_model="numpy", nogil=True)
def crossing(profile: Float64, start: int, way: int, level: float) -> float:
    """Index, with a fraction, at which a profile (T,) falls below the level from `start` on in one way; NaN where it does not."""
    k = start
    while 0 <= k + way < profile.shape[0]:
        here, there = profile[k], profile[k + way]
        if math.isnan(there):
            return math.nan
        if there < level:
            share = (here - level) / (here - there) if here > there else 0.0
            return k + way * min(max(share, 0.0), 1.0)
        k += way
    return math.nan
