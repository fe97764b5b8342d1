"""Simplification of arcs by Douglas and Peucker (1973), in whole numbers, and the check that simplified arcs only meet at nodes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BLOCK = 256


def simplified(points: IntArray, tolerance: float) -> IntArray:
    """The points (K, 2) without those that lie within the tolerance of the line through the others; both ends stay.

    Of a loop the point that is farthest from its ends stays too.
    """
    if len(points) < 3:
        return points
    keep = np.zeros(len(points), bool)
    keep[[0, -1]] = True
    spans = [(0, len(points) - 1)]
    if (points[0] == points[-1]).all():
        farthest = int(np.argmax(((points - points[0]) ** 2).sum(axis=1)))
        keep[farthest] = True
        spans = [(0, farthest), (farthest, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        off2, scale2 = _off_line(points[first + 1 : last], points[first], points[last])
        worst = int(np.argmax(off2))
        if off2[worst] > tolerance**2 * scale2:
            keep[first + 1 + worst] = True
            spans += [(first, first + 1 + worst), (first + 1 + worst, last)]
    return points[keep]


def _off_line(points: IntArray, a: IntArray, b: IntArray) -> tuple[IntArray, int]:
    """Squared distances of points (K, 2) from the segment from a to b, times the second: its squared length."""
    step = b - a
    length2 = int(step @ step)
    from_a, from_b = points - a, points - b
    across = from_a[:, 0] * step[1] - from_a[:, 1] * step[0]
    along = from_a @ step
    beside = np.where(along < 0, (from_a**2).sum(axis=1), (from_b**2).sum(axis=1)) * length2
    return np.where((along >= 0) & (along <= length2), across**2, beside), length2


def entangled(lines: Sequence[IntArray]) -> set[int]:
    """The numbers of the lines (K, 2) that meet another, or themselves, elsewhere than at their ends; empty where all is clean.

    Two lines of one segment each may be one and the same segment.
    """
    found = _with_shared_points(lines)
    a, b = np.vstack([line[:-1] for line in lines]), np.vstack([line[1:] for line in lines])
    of = np.repeat(np.arange(len(lines)), [len(line) - 1 for line in lines])
    single = np.array([len(line) == 2 for line in lines])[of]
    for start in range(0, len(a), BLOCK):
        i, j = _near_pairs(a, b, start)
        bad = _meet(a[i], b[i], a[j], b[j]) & ~(_same(a[i], b[i], a[j], b[j]) & single[i] & single[j])
        found.update(of[i[bad]].tolist(), of[j[bad]].tolist())
    return found


def _with_shared_points(lines: Sequence[IntArray]) -> set[int]:
    """Those with a point between their ends that another has too, or twice; and loops that have shrunk to less than a triangle."""
    seen: dict[tuple[int, int], int] = {}
    found = {number for number, line in enumerate(lines) if (line[0] == line[-1]).all() and len({*map(tuple, line.tolist())}) < 3}
    ends = {tuple(point) for line in lines for point in (line[0].tolist(), line[-1].tolist())}
    for number, line in enumerate(lines):
        for x, y in line[1:-1].tolist():
            other = seen.setdefault((x, y), number)
            if (x, y) in ends:
                found.add(number)
            if other != number:
                found |= {other, number}
        if len({*map(tuple, line[1:-1].tolist())}) < len(line) - 2:
            found.add(number)
    return found


def _near_pairs(a: IntArray, b: IntArray, start: int) -> tuple[IntArray, IntArray]:
    """Segments from a to b (N, 2) of a block, and later ones whose boxes touch theirs."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    rows = slice(start, start + BLOCK)
    touch = ((low[rows, None] <= high[None, start:]) & (high[rows, None] >= low[None, start:])).all(axis=2)
    i, j = np.nonzero(touch)
    later = j > i
    return i[later] + start, j[later] + start


def _meet(a: IntArray, b: IntArray, c: IntArray, d: IntArray) -> NDArray[np.bool_]:
    """Whether segments a b and c d, (N, 2) each, whose boxes touch, have more in common than one end."""
    turns = [_turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)]
    crossing = (turns[0] * turns[1] <= 0) & (turns[2] * turns[3] <= 0)
    flat = (turns[0] == 0) & (turns[1] == 0)
    shared, folded = np.zeros(len(a), bool), np.zeros(len(a), bool)
    for p, from_p in ((a, b), (b, a)):
        for q, from_q in ((c, d), (d, c)):
            here = (p == q).all(axis=1)
            shared |= here
            folded |= here & flat & (((from_p - p) * (from_q - q)).sum(axis=1) > 0)
    return np.asarray(np.where(shared, folded, crossing))


def _same(a: IntArray, b: IntArray, c: IntArray, d: IntArray) -> NDArray[np.bool_]:
    def both(p: IntArray, q: IntArray) -> NDArray[np.bool_]:
        return np.asarray((p == c).all(axis=1) & (q == d).all(axis=1))

    return both(a, b) | both(b, a)


def _turn(a: IntArray, b: IntArray, c: IntArray) -> IntArray:
    """1 where c lies left of the line from a to b, -1 right, 0 on it."""
    return np.asarray(np.sign((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])))
