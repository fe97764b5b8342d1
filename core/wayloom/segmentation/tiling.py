"""Tiling of a wide frame into overlapping near-square tiles for a network with a square input.

Resizing a whole 3:1 frame to a square distorts shapes that the network was trained on; near-square tiles keep them.
"""

from dataclasses import dataclass

_OVERLAP = 0.25
"""Share of a tile that lies over its neighbours, so that nothing is judged from a tile's edge alone."""


@dataclass(frozen=True, slots=True)
class Tile:
    """start, stop: the columns (or rows) that the network sees; keep_start, keep_stop: those whose labels are taken from it."""

    start: int
    stop: int
    keep_start: int
    keep_stop: int


def tiles_along(length: int, across: int) -> list[Tile]:
    """Cut `length` pixels into tiles about as long as `across`; what is kept meets in the middle of each overlap, without gaps."""
    count = max(1, round(length / across))
    if count == 1:
        return [Tile(0, length, 0, length)]
    size = min(length, round(length / (count - _OVERLAP * (count - 1))))
    starts = [round(i * (length - size) / (count - 1)) for i in range(count)]
    cuts = [0, *((starts[i] + size + starts[i + 1]) // 2 for i in range(count - 1)), length]
    return [Tile(start, start + size, cuts[i], cuts[i + 1]) for i, start in enumerate(starts)]
