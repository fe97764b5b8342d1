"""Height surface of the ground: robust heights of cells, a broad surface of their blocks, planes held to it that stop at steps."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

ROUNDS = 3
LEAST_BLOCKS = 0.25


@njit(cache=True, error_model="numpy", nogil=True)
def robust_mean(values, variances, order, low, high):  # type: ignore[no-untyped-def]
    """Mean of values[order[low:high]] by weights of Cauchy around their median, and the sum of its weights (1/variance)."""
    count = high - low
    held = np.empty(count)
    for k in range(count):
        value, place = values[order[low + k]], k
        while place > 0 and held[place - 1] > value:
            held[place] = held[place - 1]
            place -= 1
        held[place] = value
    mean = 0.5 * (held[count // 2] + held[(count - 1) // 2])
    information = 0.0
    for _ in range(2):
        total, information = 0.0, 0.0
        for k in range(low, high):
            n = order[k]
            rest = values[n] - mean
            weight = 1.0 / (variances[n] + 0.25 * rest * rest)
            total += weight * rest
            information += weight
        mean += total / information
    return mean, information


@njit(cache=True, error_model="numpy", nogil=True)
def cell_heights(keys, order, values, variances, height, information, group):  # type: ignore[no-untyped-def]
    """Of the samples of each cell (keys 2 * cell + group, `order` sorts them): the robust mean of the group that is surer.

    Fills height, information (1/m^2) and group (1 or 2) at the cells that have samples, all flat.
    """
    low = 0
    while low < len(order):
        key = keys[order[low]]
        high = low
        while high < len(order) and keys[order[high]] == key:
            high += 1
        mean, weight = robust_mean(values, variances, order, low, high)
        cell = key // 2
        if weight > information[cell]:
            height[cell], information[cell], group[cell] = mean, weight, key % 2 + 1
        low = high


@njit(cache=True, error_model="numpy", nogil=True)
def _taper(radius: int) -> Float64:
    """(2 radius + 1, 2 radius + 1): weights that fall to 0 half a cell further than the radius."""
    out = np.zeros((2 * radius + 1, 2 * radius + 1))
    for i in range(-radius, radius + 1):
        for j in range(-radius, radius + 1):
            out[i + radius, j + radius] = max(1.0 - (i * i + j * j) / ((radius + 0.5) * (radius + 0.5)), 0.0)
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def _plane(
    height: Float64, information: Float64, group: NDArray[np.uint8], of: int, r: int, c: int, taper: Float64, step: float,
    level: float, prior: float, trust: float, near: Float64,
) -> tuple[float, float]:  # fmt: skip
    """Level at cell (r, c) of the plane over the neighbours of group `of`, and the sum of its weights; no sum without neighbours.

    taper : (2 radius + 1, 2 radius + 1) weights of the neighbours, 0 where they are too far
    level : what the weights of Cauchy start from; prior counts as a measurement of the cell itself with the information `trust`
    near  : (4, (2 radius + 1)^2) room to work in
    """
    (rows, columns), radius = height.shape, taper.shape[0] // 2
    count = 0
    for i in range(max(r - radius, 0), min(r + radius + 1, rows)):
        for j in range(max(c - radius, 0), min(c + radius + 1, columns)):
            weight = information[i, j] * taper[i - r + radius, j - c + radius]
            if weight > 0.0 and group[i, j] == of:
                near[0, count], near[1, count], near[2, count], near[3, count] = j - c, i - r, height[i, j], weight
                count += 1
    slope_c, slope_r, total = 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        a00, b0 = trust, trust * prior
        a01 = a02 = a11 = a12 = a22 = b1 = b2 = 0.0
        for n in range(count):
            x, y, h = near[0, n], near[1, n], near[2, n]
            rest = (h - level - slope_c * x - slope_r * y) / step
            w = near[3, n] / (1.0 + rest * rest)
            a00 += w
            a01 += w * x
            a02 += w * y
            a11 += w * x * x
            a12 += w * x * y
            a22 += w * y * y
            b0 += w * h
            b1 += w * x * h
            b2 += w * y * h
        total = a00
        if total <= 0.0:
            break
        a11 += total  # slopes are held near zero as if by a mean neighbour one cell away
        a22 += total
        m0, mx, my = b0 / a00, a01 / a00, a02 / a00
        sxx, sxy, syy = a11 - a01 * mx, a12 - a01 * my, a22 - a02 * my
        sxh, syh = b1 - mx * b0, b2 - my * b0
        det = sxx * syy - sxy * sxy
        slope_c, slope_r = (sxh * syy - syh * sxy) / det, (syh * sxx - sxh * sxy) / det
        level = m0 - slope_c * mx - slope_r * my
    return level, total


@njit(cache=True, error_model="numpy", nogil=True)
def block_heights(height, information, group, size, step, height_out, information_out):  # type: ignore[no-untyped-def]
    """Robust means of the cells of each group in blocks of size x size cells, by weights of Cauchy with the scale `step` m.

    height, information, group (rows, columns), information 0 where there is none.
    Fills height_out m and information_out 1/m^2 (2, block rows, block columns), 0 where a group has no cells in a block.
    """
    rows, columns = height.shape
    for g in range(height_out.shape[0]):
        for r in range(height_out.shape[1]):
            for c in range(height_out.shape[2]):
                mean, total = 0.0, 0.0
                for n in range(ROUNDS):
                    total, moment = 0.0, 0.0
                    for i in range(size * r, min(size * r + size, rows)):
                        for j in range(size * c, min(size * c + size, columns)):
                            if information[i, j] > 0.0 and group[i, j] == g + 1:
                                rest = (height[i, j] - mean) / step if n > 0 else 0.0
                                w = information[i, j] / (1.0 + rest * rest)
                                total += w
                                moment += w * height[i, j]
                    if total <= 0.0:
                        break
                    mean = moment / total
                height_out[g, r, c], information_out[g, r, c] = mean, total


@njit(cache=True, error_model="numpy", nogil=True)
def smooth_blocks(height, information, radius, step, height_out, variance_out):  # type: ignore[no-untyped-def]
    """Planes over the blocks of `block_heights` within `radius` blocks, each group by itself, from the mean of all of them on.

    Fills height_out m and variance_out m^2 (2, block rows, block columns), 0 where the group has no cells in the block.
    """
    groups, rows, columns = height.shape
    one, taper = np.ones((rows, columns), np.uint8), _taper(radius)
    near = np.empty((4, taper.size))
    for g in range(groups):
        for r in range(rows):
            for c in range(columns):
                if information[g, r, c] <= 0.0:
                    continue
                total, moment = 0.0, 0.0
                for i in range(max(r - radius, 0), min(r + radius + 1, rows)):
                    for j in range(max(c - radius, 0), min(c + radius + 1, columns)):
                        total += information[g, i, j]
                        moment += information[g, i, j] * height[g, i, j]
                level, weights = _plane(height[g], information[g], one, 1, r, c, taper, step, moment / total, 0.0, 0.0, near)
                height_out[g, r, c], variance_out[g, r, c] = level, 1.0 / weights


@njit(cache=True, error_model="numpy", nogil=True)
def _among_blocks(height, variance, size, r, c):  # type: ignore[no-untyped-def]
    """Height and variance between the middles of the blocks around cell (r, c), bilinear among those that have one; variance 0
    where they weigh less than LEAST_BLOCKS together."""
    y, x = (r + 0.5) / size - 0.5, (c + 0.5) / size - 0.5
    top, left = int(np.floor(y)), int(np.floor(x))
    total, h, spread = 0.0, 0.0, 0.0
    for i in range(max(top, 0), min(top + 2, height.shape[0])):
        for j in range(max(left, 0), min(left + 2, height.shape[1])):
            if variance[i, j] > 0.0:
                w = (1.0 - abs(y - i)) * (1.0 - abs(x - j))
                total += w
                h += w * height[i, j]
                spread += w * variance[i, j]
    return (h / total, spread / total) if total > LEAST_BLOCKS else (0.0, 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def smooth_surface(  # type: ignore[no-untyped-def]
    height, information, group, broad_height, broad_variance, size, bend2, radius, step, first, last, height_out, variance_out,
    filled,
):  # fmt: skip
    """A plane over each cell's neighbours of its group within `radius` cells, by weights of Cauchy with the scale `step` m, held to
    the broad surface of the group; of the rows from `first` to `last` - 1.

    height, information, group (rows, columns), information 0 where there is none.
    broad_height, broad_variance (2, block rows, block columns) of `smooth_blocks`, blocks of `size` cells; bend2 m^2: of what the
    ground is off its broad surface, in the variance of the cells
    Fills height_out m and variance_out m^2 (0: no surface); filled is where a cell without height of its own got one: it must have
    neighbours in all four quadrants, and belongs to the group that weighs more around it.
    """
    columns = height.shape[1]
    taper, counts = _taper(radius), _counts(information)
    near = np.empty((4, taper.size))
    for r in range(first, last):
        for c in range(columns):
            own = information[r, c]
            of, level = int(group[r, c]), height[r, c]
            if own <= 0.0:
                if not _is_enclosed(counts, radius, r, c):
                    continue
                of, level = _around(height, information, group, radius, r, c)
            prior, variance = _among_blocks(broad_height[of - 1], broad_variance[of - 1], size, r, c)
            trust = 1.0 / (variance + bend2) if variance > 0.0 else 0.0
            if trust > 0.0:
                level = (own * level + trust * prior) / (own + trust)
            level, total = _plane(height, information, group, of, r, c, taper, step, level, prior, trust, near)
            if total > 0.0:
                height_out[r, c], variance_out[r, c], filled[r, c] = level, 1.0 / total, own <= 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def _counts(information: Float64) -> NDArray[np.int32]:
    """(rows + 1, columns + 1) int32: how many cells have information before each row and column."""
    rows, columns = information.shape
    out = np.zeros((rows + 1, columns + 1), np.int32)
    for r in range(rows):
        count = 0
        for c in range(columns):
            count += information[r, c] > 0.0
            out[r + 1, c + 1] = out[r, c + 1] + count
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def _is_enclosed(counts: NDArray[np.int32], radius: int, r: int, c: int) -> bool:
    """Whether each of the four quadrants around a cell, its row and column left out, has cells with information."""
    top, bottom = max(r - radius, 0), min(r + radius + 1, counts.shape[0] - 1)
    first, last = max(c - radius, 0), min(c + radius + 1, counts.shape[1] - 1)
    for low, high in ((top, r), (r + 1, bottom)):
        for left, right in ((first, c), (c + 1, last)):
            if counts[high, right] - counts[low, right] - counts[high, left] + counts[low, left] == 0:
                return False
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def _around(height, information, group, radius, r, c):  # type: ignore[no-untyped-def]
    """The group that weighs more around a cell without height, and its mean height."""
    rows, columns = height.shape
    road, beside, of_road, of_beside = 0.0, 0.0, 0.0, 0.0
    for i in range(max(r - radius, 0), min(r + radius + 1, rows)):
        for j in range(max(c - radius, 0), min(c + radius + 1, columns)):
            if information[i, j] > 0.0:
                w = information[i, j] / (1.0 + (i - r) ** 2 + (j - c) ** 2)
                if group[i, j] == 1:
                    road += w
                    of_road += w * height[i, j]
                else:
                    beside += w
                    of_beside += w * height[i, j]
    return (1, of_road / road) if road >= beside else (2, of_beside / beside)
