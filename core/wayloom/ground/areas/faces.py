"""Faces of a partition: the polygons that simplified arcs enclose, as clean as the cells that they were drawn from.

Arcs that meet at nodes alone make simple rings. Where moreover every outer ring runs counter-clockwise, every hole clockwise and
within its outer ring and in no other hole, no point has a negative winding number about any face; the windings of all faces add up
to the square's, which is one. So each point of the square lies in exactly one face.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.areas.arcs import Arc
from wayloom.ground.areas.simplification import entangled, simplified

IntArray = NDArray[np.int64]
Rings = list[IntArray]
"""Of a face: the outer one (K, 2), then its holes, each without its first point again at the end."""


def faces_of(arcs: Sequence[Arc], tolerance: float) -> dict[int, Rings]:
    """The rings of each patch that the arcs enclose, in lattice units; without those that have shrunk to nothing.

    tolerance : of the simplification. Arcs that would meet, or faces that would turn over, are drawn more finely, at last exactly.
    """
    fineness = np.zeros(len(arcs), np.int64)
    while True:
        lines = [simplified(arc.points, _tolerance(tolerance, steps)) for arc, steps in zip(arcs, fineness.tolist(), strict=True)]
        bad = entangled(lines)
        if not bad:
            faces = _assembled(arcs, lines)
            spoilt = {face for face, rings in faces.items() if not _is_clean(rings)}
            bad = {number for number, arc in enumerate(arcs) if spoilt & {arc.left, arc.right}}
            if not bad:
                return {face: rings for face, rings in sorted(faces.items()) if rings}
        rough = [number for number in sorted(bad) if _tolerance(tolerance, int(fineness[number])) > 0.0]
        if not rough:
            raise AssertionError("arcs of a raster of cells meet at nodes alone")
        fineness[rough] += 1


def _tolerance(tolerance: float, steps: int) -> float:
    return tolerance / 2**steps if steps < 3 else 0.0


def _assembled(arcs: Sequence[Arc], lines: Sequence[IntArray]) -> dict[int, Rings]:
    """The rings of each patch, the outer one first. A half-arc: (number, whether it is walked backwards), its patch on the left."""
    leaving = {}
    for number, arc in enumerate(arcs):
        leaving[(*arc.points[0].tolist(), arc.leaves)] = (number, False)
        leaving[(*arc.points[-1].tolist(), (arc.arrives + 2) % 4)] = (number, True)
    faces: dict[int, Rings] = {arc_face: [] for arc in arcs for arc_face in (arc.left, arc.right) if arc_face}
    free = dict.fromkeys(leaving.values())
    while free:
        half = next(iter(free))
        face = arcs[half[0]].right if half[1] else arcs[half[0]].left
        ring: list[list[int]] = []
        while half in free:
            del free[half]
            number, backwards = half
            line = lines[number][::-1] if backwards else lines[number]
            ring += line[:-1].tolist()
            way = (arcs[number].leaves + 2) % 4 if backwards else arcs[number].arrives
            x, y = line[-1].tolist()
            half = next(leaving[x, y, turn % 4] for turn in (way + 1, way, way - 1) if (x, y, turn % 4) in leaving)
        if face:
            faces[face] += _simple_rings(ring)
    return {face: sorted(rings, key=lambda one: doubled_area(one) < 0) for face, rings in faces.items()}


def _simple_rings(ring: Sequence[Sequence[int]]) -> Rings:
    """The parts of a ring that touches itself at points, those without an area left out."""
    out: Rings = []
    open_ring: list[tuple[int, int]] = []
    at: dict[tuple[int, int], int] = {}
    for x, y in ring:
        if (x, y) in at:
            start = at[x, y]
            part, open_ring = open_ring[start:], open_ring[:start]
            for point in part:
                del at[point]
            out.append(np.array(part, np.int64))
        at[x, y] = len(open_ring)
        open_ring.append((x, y))
    out.append(np.array(open_ring, np.int64))
    return [one for one in out if doubled_area(one) != 0]


def doubled_area(ring: IntArray) -> int:
    """Twice the area of a ring (K, 2), negative where it runs clockwise."""
    x, y = ring[:, 0], ring[:, 1]
    return int((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _is_clean(rings: Rings) -> bool:
    """Whether the first ring alone runs counter-clockwise, and each other lies in it and in no other. Nothing is clean as well."""
    if not rings:
        return True
    if [doubled_area(one) > 0 for one in rings] != [True] + [False] * (len(rings) - 1):
        return False
    for hole in rings[1:]:
        middle = (hole[0] + hole[1]).tolist()  # of a side, in halves: rings have points in common, never sides
        if sum(winding(2 * one, middle) for one in rings if one is not hole) != 1:
            return False
    return True


def winding(ring: IntArray, point: Sequence[int]) -> int:
    """How often a ring (K, 2) runs round a point that is not on it, counter-clockwise."""
    x, y = point
    a, b = ring, np.roll(ring, -1, axis=0)
    turn = (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])
    up, down = (a[:, 1] <= y) & (b[:, 1] > y) & (turn > 0), (a[:, 1] > y) & (b[:, 1] <= y) & (turn < 0)
    return int(up.sum()) - int(down.sum())
