"""Passenger car and van models around their own origin: x forward, y left, wheels on z = 0."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.models.mesh import Mesh, MeshBuilder
from wayloom.simulation.models.solids import Appearance, box, disc, tube
from wayloom.simulation.textures.materials import Material

PAINTWORK = (0.5, 0.25, 0.125)
"""Tint by which paintwork is found (`mesh.recoloured`)."""
TAIL_LAMP, BRAKE_LAMP = (0.22, 0.012, 0.010), (1.0, 0.05, 0.04)
"""Tints of rear lamps: off, and of those that brake."""
WHITE_LAMP, RUBBER = (0.9, 0.9, 0.85), (0.04, 0.04, 0.04)
MIRROR_BEHIND_WHEEL_M = 0.52
WHEEL_RADIUS_M = 0.32
SILL_M = 0.22
GLASS_RISE_M = 0.12
"""Where the roof line climbs more than this from one station to the next, the slope is a window."""
WHITE = (1.0, 1.0, 1.0)
F64 = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


@dataclass(frozen=True, slots=True)
class Shape:
    """A body as cross sections from back to front.

    stations  x, foot, belt, roof and half width of each, m; where the roof is little above the belt there is no cabin
    pillars   gaps between stations whose side is paint although there is a cabin
    wheels    x of the axles, m
    """

    stations: Sequence[tuple[float, float, float, float, float]]
    pillars: frozenset[int]
    wheels: tuple[float, float]


HATCHBACK: Final = Shape(
    (
        (-2.00, 0.42, 0.78, 0.80, 0.76),
        (-1.97, 0.28, 0.93, 0.95, 0.82),
        (-1.86, 0.24, 0.97, 1.02, 0.85),
        (-1.52, 0.22, 0.98, 1.40, 0.87),
        (-1.30, 0.22, 0.98, 1.45, 0.87),
        (-0.72, 0.22, 0.97, 1.49, 0.88),
        (-0.62, 0.22, 0.97, 1.49, 0.88),
        (0.10, 0.22, 0.96, 1.47, 0.88),
        (0.36, 0.22, 0.95, 1.41, 0.88),
        (1.08, 0.22, 0.93, 0.98, 0.87),
        (1.50, 0.22, 0.88, 0.93, 0.86),
        (1.82, 0.24, 0.79, 0.84, 0.82),
        (1.97, 0.30, 0.68, 0.73, 0.74),
        (2.03, 0.42, 0.58, 0.60, 0.66),
    ),
    frozenset({3, 5}),
    (-1.22, 1.27),
)
SALOON: Final = Shape(
    (
        (-2.30, 0.42, 0.80, 0.82, 0.76),
        (-2.26, 0.28, 0.95, 0.97, 0.82),
        (-2.12, 0.24, 0.99, 1.03, 0.85),
        (-1.62, 0.22, 1.00, 1.06, 0.87),
        (-1.02, 0.22, 0.98, 1.38, 0.88),
        (-0.80, 0.22, 0.98, 1.41, 0.88),
        (-0.22, 0.22, 0.97, 1.44, 0.89),
        (-0.12, 0.22, 0.97, 1.44, 0.89),
        (0.36, 0.22, 0.96, 1.41, 0.89),
        (0.56, 0.22, 0.95, 1.34, 0.88),
        (1.24, 0.22, 0.93, 0.98, 0.88),
        (1.75, 0.22, 0.87, 0.92, 0.87),
        (2.08, 0.24, 0.78, 0.82, 0.82),
        (2.22, 0.30, 0.68, 0.72, 0.74),
        (2.28, 0.42, 0.58, 0.60, 0.66),
    ),
    frozenset({4, 6}),
    (-1.38, 1.42),
)
ESTATE: Final = Shape(
    (
        (-2.28, 0.42, 0.80, 0.82, 0.78),
        (-2.25, 0.28, 0.96, 0.98, 0.83),
        (-2.18, 0.24, 0.99, 1.04, 0.86),
        (-1.96, 0.22, 0.99, 1.40, 0.87),
        (-1.80, 0.22, 0.99, 1.44, 0.87),
        (-1.02, 0.22, 0.98, 1.48, 0.88),
        (-0.93, 0.22, 0.98, 1.48, 0.88),
        (-0.16, 0.22, 0.97, 1.47, 0.89),
        (-0.06, 0.22, 0.97, 1.47, 0.89),
        (0.34, 0.22, 0.96, 1.43, 0.89),
        (0.54, 0.22, 0.95, 1.36, 0.88),
        (1.22, 0.22, 0.93, 0.98, 0.88),
        (1.72, 0.22, 0.87, 0.92, 0.87),
        (2.06, 0.24, 0.78, 0.82, 0.82),
        (2.20, 0.30, 0.68, 0.72, 0.74),
        (2.26, 0.42, 0.58, 0.60, 0.66),
    ),
    frozenset({3, 5, 7}),
    (-1.36, 1.40),
)
VAN: Final = Shape(
    (
        (-2.45, 0.44, 0.95, 0.97, 0.84),
        (-2.43, 0.28, 1.10, 1.14, 0.90),
        (-2.38, 0.26, 1.12, 1.30, 0.92),
        (-2.32, 0.25, 1.13, 1.86, 0.93),
        (-2.15, 0.25, 1.13, 1.93, 0.94),
        (-1.15, 0.25, 1.12, 1.97, 0.95),
        (-1.05, 0.25, 1.12, 1.97, 0.95),
        (-0.05, 0.25, 1.11, 1.97, 0.95),
        (0.08, 0.25, 1.11, 1.97, 0.95),
        (0.75, 0.25, 1.10, 1.91, 0.94),
        (0.95, 0.25, 1.09, 1.80, 0.94),
        (1.62, 0.25, 1.06, 1.18, 0.93),
        (2.05, 0.26, 0.98, 1.06, 0.91),
        (2.30, 0.28, 0.84, 0.90, 0.86),
        (2.42, 0.42, 0.66, 0.70, 0.76),
    ),
    frozenset({3, 5, 6, 7}),
    (-1.50, 1.52),
)
CAR_PROFILES: Final = (HATCHBACK, SALOON, ESTATE, VAN)


def _section(station: tuple[float, float, float, float, float]) -> F64:
    """(7, 3) left half of a cross section: sill, belly, shoulder, belt, roof edge, roof, ridge."""
    x, foot, belt, roof, half = station
    cabin = roof - belt > 0.2
    edge = (0.76 * half, roof - 0.06) if cabin else (0.86 * half, belt + 0.6 * (roof - belt))
    y = (0.93 * half, 0.99 * half, half, 0.965 * half, edge[0], 0.5 * half, 0.0)
    z = (foot, foot + 0.38 * (belt - foot), belt - 0.14, belt, edge[1], roof - 0.012, roof)
    return np.column_stack([np.full(7, x), y, z])


def car(shape: Shape) -> Mesh:
    """A car: lofted body with windows, front and back, lamps, mirrors, wheels in dark arches."""
    m, cls = MeshBuilder(), CLASS_ID["car"]
    half = np.stack([_section(s) for s in shape.stations])
    width = max(s[4] for s in shape.stations)
    for way in (1.0, -1.0):
        _half_body(m, half * (1.0, way, 1.0), shape, way)
        for x in shape.wheels:
            _arch(m, x, way, width, cls)
        _mirror(m, shape.wheels[1] - MIRROR_BEHIND_WHEEL_M, way, width, max(s[2] for s in shape.stations) - 0.04, cls)
    back, front = half[1], half[-2]
    _end(m, half[0], Material.CAR_BACK, -1.0)
    _end(m, half[-1], Material.CAR_FRONT, 1.0)
    _lamps(m, back, front, cls)
    box(
        m,
        (back[0, 0] + 0.15, -0.78, 0.16),
        (front[0, 0] - 0.15, 0.78, SILL_M + 0.1),
        Appearance(Material.PAINT, cls, 0, RUBBER),
        bottom=True,
    )
    return m.build()


def _half_body(m: MeshBuilder, p: F64, shape: Shape, way: float) -> None:
    """One side of the body from its sections p (S, 7, 3)."""
    cls = CLASS_ID["car"]
    normals = _smooth_normals(p, way)
    x0, length = p[0, 0, 0], p[-1, 0, 0] - p[0, 0, 0]
    cabin = [s[3] - s[2] > 0.2 for s in shape.stations]
    roofs = [s[3] for s in shape.stations]
    for i in range(len(p) - 1):
        for j in range(6):
            ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            if way < 0:
                ring = ring[::-1]
            corners, shade = np.array([p[a] for a in ring]), np.array([normals[a] for a in ring])
            material, tint = Material.PAINT, PAINTWORK
            uv = np.column_stack([corners[:, 0] / 2, corners[:, 1] / 2])
            glazed_side = j == 3 and cabin[i] and cabin[i + 1] and i not in shape.pillars
            climbs = abs(roofs[i + 1] - roofs[i]) > GLASS_RISE_M
            if j < 3:
                belt = max(shape.stations[i][2], shape.stations[i + 1][2])
                uv = np.column_stack([(corners[:, 0] - x0) / length, 1 - (corners[:, 2] - SILL_M) / (belt - SILL_M)])
                material = Material.CAR_SIDE
            elif glazed_side or (j >= 4 and climbs) or (j == 3 and climbs and cabin[i] != cabin[i + 1] and i not in shape.pillars):
                material, tint = Material.GLASS, WHITE
            m.quads([corners], [np.clip(uv, 0.002, 0.998) if j < 3 else uv], material, cls, 0, tint, [shade])


def _smooth_normals(p: F64, way: float) -> F64:
    """(S, 7, 3) unit outward normals of a grid of points, from its central differences."""
    along, across = np.gradient(p, axis=0), np.gradient(p, axis=1)
    n = np.cross(along, across) * way
    n[:, -1, 1] = 0.0  # the ridge is shared by both sides
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=2, keepdims=True), 1e-9))


def _end(m: MeshBuilder, section: F64, material: Material, way: float) -> None:
    """The face that closes the body at its back (way -1) or front (+1), and what it rests on: a quad that wraps the bumper."""
    y, low, high = section[2, 1], section[0, 2] - 0.10, section[3, 2] + 0.02
    x = section[0, 0] + 0.012 * way
    corners = [(x, y, low), (x, -y, low), (x, -y, high), (x, y, high)]
    uv = [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]
    if way > 0:
        corners = [corners[k] for k in (1, 0, 3, 2)]
    lean = (way * 0.95, 0.0, 0.3)
    m.quads([corners], [uv], material, CLASS_ID["car"], 0, PAINTWORK, [[lean] * 4])


def _lamps(m: MeshBuilder, back: F64, front: F64, class_id: int) -> None:
    """Head lamps and rear lamps at the corners, mirrors, exhaust."""
    for way in (1.0, -1.0):
        y, z = back[2, 1] * way, back[2, 2]
        inner, outer = sorted((y - 0.30 * way, y - 0.02 * way))
        box(
            m,
            (back[0, 0] - 0.05, inner, z - 0.14),
            (back[0, 0] + 0.10, outer, z + 0.09),
            Appearance(Material.LIT, class_id, 0, TAIL_LAMP),
        )
        y, z = front[2, 1] * way, front[2, 2]
        inner, outer = sorted((y - 0.34 * way, y - 0.01 * way))
        box(
            m,
            (front[0, 0] - 0.12, inner, z - 0.10),
            (front[0, 0] + 0.055, outer, z + 0.06),
            Appearance(Material.PAINT, class_id, 0, WHITE_LAMP),
        )


def _arch(m: MeshBuilder, x: float, way: float, half: float, class_id: int) -> None:
    """A wheel in its dark arch."""
    disc(m, (x, way * (half + 0.004), 0.36), 0.385, Appearance(Material.PAINT, class_id, tint=(0.01, 0.01, 0.01)), way)
    wheel(m, x, way * (half + 0.012), WHEEL_RADIUS_M, class_id)


def _mirror(m: MeshBuilder, x: float, way: float, half: float, belt: float, class_id: int) -> None:
    """An outside mirror on the belt at x m."""
    lo, hi = sorted((way * (half - 0.04), way * (half + 0.17)))
    box(m, (x - 0.07, lo, belt), (x + 0.07, hi, belt + 0.13), Appearance(Material.PAINT, class_id, 0, PAINTWORK), bottom=True)


def wheel(m: MeshBuilder, x: float, y: float, radius: float, class_id: int) -> None:
    """A wheel 0.2 m broad whose outer face lies at y."""
    side = 1.0 if y > 0 else -1.0
    disc(m, (x, y, radius), radius, Appearance(Material.WHEEL, class_id), side)
    tube(
        m,
        (x, y - 0.2 * side, radius),
        (x, y, radius),
        (radius, radius),
        Appearance(Material.PAINT, class_id, 0, (0.03, 0.03, 0.03)),
        14,
    )
