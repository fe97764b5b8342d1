"""Geometric primitives: boxes, tubes, bodies of revolution, discs, foliage cards."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayloom.simulation.models.mesh import WHITE, MeshBuilder, cross

F64 = NDArray[np.float64]
ACROSS_X, ACROSS_Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
COARSE_EVERY = 4
"""Of a far spray's cards one in so many is drawn, larger."""
BOX_SIDES = np.array([(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7), (3, 2, 1, 0)])
"""Corners of a box's sides (four walls, top, bottom); corners 0 to 3 run counter-clockwise at the foot, 4 to 7 above them."""


@dataclass(frozen=True, slots=True)
class Appearance:
    """Material of a body's surface with its labels: train id class_id, instance number, tint (3,) linear RGB."""

    material: int
    class_id: int
    instance: int = 0
    tint: ArrayLike = WHITE

    def quads(self, m: MeshBuilder, corners: ArrayLike, uv: ArrayLike, normals: F64 | None = None) -> None:
        """Add quadrilaterals of this appearance; arguments as in `MeshBuilder.quads`."""
        m.quads(corners, uv, self.material, self.class_id, self.instance, self.tint, normals)


def box(
    m: MeshBuilder,
    lo: ArrayLike,
    hi: ArrayLike,
    appearance: Appearance,
    metres: float = 2.0,
    at: tuple[float, float] = (0.0, 0.0),
    yaw: float = 0.0,
    bottom: bool = False,
) -> None:
    """The box from lo to hi (3,) m, turned by yaw around its own origin and moved to `at`; `metres` a texture repeat."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(lo, float), np.asarray(hi, float)
    c, s = np.cos(yaw), np.sin(yaw)
    foot = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) @ np.array([[c, s], [-s, c]]) + at
    corners = np.vstack([np.column_stack([foot, np.full(4, z)]) for z in (z0, z1)])[BOX_SIDES[: 6 if bottom else 5]]
    dx, dy, dz = (x1 - x0) / metres, (y1 - y0) / metres, (z1 - z0) / metres
    sizes = [(dx, dz), (dy, dz), (dx, dz), (dy, dz), (dx, dy), (dx, dy)][: len(corners)]
    uv = [[(0, h), (w, h), (w, 0), (0, 0)] for w, h in sizes]
    appearance.quads(m, corners, uv)


def tube(
    m: MeshBuilder,
    start: ArrayLike,
    end: ArrayLike,
    radii: tuple[float, float],
    appearance: Appearance,
    sides: int = 6,
    metres: float = 2.0,
    squash: float = 1.0,
) -> None:
    """A tapered tube from start to end (3,) m, open at its ends, with rounded shading; squash narrows it along one side axis."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    axis = b - a
    length = float(np.linalg.norm(axis))
    axis /= length
    side = cross(axis, ACROSS_X if abs(axis[0]) < 0.7 else ACROSS_Z)
    side /= np.linalg.norm(side)
    other = cross(axis, side)
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    ring = np.cos(angle)[:, None] * side + squash * np.sin(angle)[:, None] * other
    low, high = a + radii[0] * ring, b + radii[1] * ring
    corners = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    normal = ring / np.linalg.norm(ring, axis=1, keepdims=True)
    normals = np.stack([normal[:-1], normal[1:], normal[1:], normal[:-1]], axis=1)
    k = np.arange(sides) / sides
    v = length / metres
    uv = np.stack([np.stack([u, np.full(sides, w)], 1) for u, w in ((k, v), (k + 1 / sides, v), (k + 1 / sides, 0.0), (k, 0.0))], 1)
    appearance.quads(m, corners, uv, normals)


def lathe(
    m: MeshBuilder,
    centre: ArrayLike,
    profile: Sequence[tuple[float, float]],
    appearance: Appearance,
    sides: int = 14,
) -> None:
    """A body turned around the y axis through `centre` (3,) m: its profile's radius and y, from one end to the other, m."""
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    ring = np.column_stack([np.cos(angle), np.zeros(sides + 1), np.sin(angle)])
    for (r0, y0), (r1, y1) in pairwise(profile):
        a, b = (np.asarray(centre, float) + (0.0, y, 0.0) + r * ring for r, y in ((r0, y0), (r1, y1)))
        corners = np.stack([a[:-1], a[1:], b[1:], b[:-1]], axis=1)
        slope = np.array([0.0, r0 - r1, 0.0]) + (y1 - y0) * ring
        normals = slope / max(float(np.hypot(r0 - r1, y1 - y0)), 1e-9)
        n = np.stack([normals[:-1], normals[1:], normals[1:], normals[:-1]], axis=1)
        appearance.quads(m, corners, corners[..., [0, 2]], n)


def post(
    m: MeshBuilder,
    x: float,
    y: float,
    z: tuple[float, float],
    radii: tuple[float, float],
    appearance: Appearance,
    sides: int = 7,
) -> None:
    """An upright tube at (x, y) from z[0] to z[1] m."""
    tube(m, (x, y, z[0]), (x, y, z[1]), radii, appearance, sides)


def disc(
    m: MeshBuilder,
    centre: ArrayLike,
    radius: float,
    appearance: Appearance,
    outward: float,
    sides: int = 14,
) -> None:
    """A disc across the y axis, facing `outward` (+1 or -1 along y), its texture's radius 0.45 at the rim."""
    c = np.asarray(centre, float)
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    rim = c + radius * np.column_stack([np.cos(angle), np.zeros(sides + 1), np.sin(angle)])
    uv_rim = 0.5 + 0.45 * np.column_stack([np.cos(angle), -np.sin(angle)])
    corners = np.stack([np.broadcast_to(c, (sides, 3)), rim[:-1], rim[1:], rim[1:]], axis=1)
    uv = np.stack([np.full((sides, 2), 0.5), uv_rim[:-1], uv_rim[1:], uv_rim[1:]], axis=1)
    appearance.quads(m, corners, uv, np.broadcast_to((0.0, outward, 0.0), corners.shape))


def grid_between(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, step_m: float) -> F64:
    """Corners a, b, c, d (2,) m of a quadrilateral to (Q, 4, 2): cut into pieces of about step_m along both directions."""
    a, b, c, d = (np.asarray(p, float) for p in (a, b, c, d))
    columns = max(1, int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - d)) / step_m)))
    rows = max(1, int(np.ceil(max(np.linalg.norm(d - a), np.linalg.norm(c - b)) / step_m)))
    s, t = np.linspace(0, 1, columns + 1)[None, :, None], np.linspace(0, 1, rows + 1)[:, None, None]
    p = (a * (1 - s) + b * s) * (1 - t) + (d * (1 - s) + c * s) * t
    return np.stack([p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]], axis=2).reshape(-1, 4, 2)


def at_height(corners: F64, z: float) -> F64:
    """(…, 2) to (…, 3) with one height."""
    return np.concatenate([corners, np.full((*corners.shape[:-1], 1), z)], axis=-1)


def cards(
    m: MeshBuilder,
    rng: np.random.Generator,
    centres: F64,
    half_sizes: F64,
    normals: F64,
    appearance: Appearance,
) -> None:
    """Square cards turned at random around their centres (N, 3), half_sizes (N,), shaded as if they faced normals (N, 3).

    The appearance's tint is (3,), or (N, 3): one a card.
    """
    a = rng.normal(size=centres.shape)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = cross(a, rng.normal(size=centres.shape))
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    a, b = a * half_sizes[:, None], b * half_sizes[:, None]
    tints = np.broadcast_to(np.asarray(appearance.tint, float), (len(centres), 3))
    if m.coarse:
        grown = np.sqrt(COARSE_EVERY)
        centres, normals, tints = centres[::COARSE_EVERY], normals[::COARSE_EVERY], tints[::COARSE_EVERY]
        a, b = grown * a[::COARSE_EVERY], grown * b[::COARSE_EVERY]
    corners = np.stack([centres - a - b, centres + a - b, centres + a + b, centres - a + b], axis=1)
    uv = np.broadcast_to(np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float), (len(centres), 4, 2))
    replace(appearance, tint=tints).quads(m, corners, uv, np.repeat(normals[:, None], 4, axis=1))
