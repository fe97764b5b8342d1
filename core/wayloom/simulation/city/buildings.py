"""Procedural buildings: town houses in rows, and detached houses with gardens."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.streets import F64
from wayloom.simulation.models.mesh import MeshBuilder
from wayloom.simulation.models.solids import Appearance, box, tube
from wayloom.simulation.textures.materials import FACADES, Material
from wayloom.simulation.textures.paint_facades import BAY_M, BAYS, FLOOR_M, FLOORS

BUILDING = CLASS_ID["building"]
SHOP_M = 3.4
FOOT_M = -1.0
"""Walls reach below the ground, which may slope."""
EAVES_M = 0.45
ROOF_TILE_M = 6.0
STONE = (1.25, 1.15, 0.95)
FAMILY_FRONTS = (Material.PLASTER_CREAM, Material.PLASTER_WHITE, Material.PLASTER_OCHRE, Material.CLINKER)


@dataclass(frozen=True, slots=True)
class Footprint:
    """A rectangle: front from p to q (2,) m with the building on its left, depth m."""

    p: F64
    q: F64
    depth_m: float

    @property
    def width_m(self) -> float:
        """Length of the front."""
        return float(np.hypot(*(self.q - self.p)))

    @property
    def along(self) -> F64:
        """Unit vector from p to q."""
        return np.asarray((self.q - self.p) / self.width_m)

    @property
    def inward(self) -> F64:
        """Unit vector from the front to the back."""
        d = self.along
        return np.array([-d[1], d[0]])

    @property
    def yaw(self) -> float:
        """Direction of the front, rad."""
        return float(np.arctan2(self.along[1], self.along[0]))

    def corners(self, out: float = 0.0) -> F64:
        """(4, 2) p, q, back right, back left, moved outwards by `out` m."""
        d, n = self.along * out, self.inward * out
        back = self.inward * self.depth_m
        return np.array([self.p - d - n, self.q + d - n, self.q + back + d + n, self.p + back - d + n])


def _walls(
    m: MeshBuilder, foot: Footprint, z: tuple[float, float], front: Material, side: Material, tint: F64, number: int, shift: float
) -> None:
    """Four walls whose windows fit the bays and floors; `side` covers all but the front."""
    corners = foot.corners()
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        bays = max(1, round(float(np.hypot(*(b - a))) / BAY_M)) / BAYS
        floors = (z[1] - z[0]) / FLOOR_M / FLOORS
        quad = [(*a, z[0]), (*b, z[0]), (*b, z[1]), (*a, z[1])]
        uv = [(shift, floors), (shift + bays, floors), (shift + bays, 0), (shift, 0)]
        m.quads([quad], [uv], front if k == 0 else side, BUILDING, number, tint)


def _gable_roof(
    m: MeshBuilder,
    foot: Footprint,
    eaves: float,
    rise: float,
    tint: F64,
    roof_tint: F64,
    number: int,
    rng: np.random.Generator,
) -> None:
    """A ridge along the front, eaves that stand out, gables, chimneys and dormers."""
    c, wide = foot.corners(), foot.corners(EAVES_M)
    drop = rise * 2 * EAVES_M / foot.depth_m
    left, right = (c[0] + c[3]) / 2 - foot.along * EAVES_M, (c[1] + c[2]) / 2 + foot.along * EAVES_M
    slope = float(np.hypot(foot.depth_m / 2, rise))
    uv = [(0, slope / ROOF_TILE_M), (foot.width_m / ROOF_TILE_M, slope / ROOF_TILE_M), (foot.width_m / ROOF_TILE_M, 0), (0, 0)]
    for a, b, ra, rb in ((wide[0], wide[1], left, right), (wide[2], wide[3], right, left)):
        quad = [(*a, eaves - drop), (*b, eaves - drop), (*rb, eaves + rise), (*ra, eaves + rise)]
        m.quads([quad], [uv], Material.ROOF_TILES, BUILDING, number, roof_tint)
    for a, b in ((c[1], c[2]), (c[3], c[0])):
        top = (a + b) / 2
        quad = [(*a, eaves), (*b, eaves), (*top, eaves + rise - 0.1), (*top, eaves + rise - 0.1)]
        m.quads([quad], [[(0, 1), (2, 1), (1, 0), (1, 0)]], Material.CONCRETE, BUILDING, number, tint * 1.3)
    for share in rng.uniform(0.12, 0.88, rng.integers(0, 3)):
        x, y = left + (right - left) * share
        box(
            m,
            (-0.35, -0.3, eaves + rise - 0.8),
            (0.35, 0.3, eaves + rise + 0.9),
            Appearance(Material.BRICK, BUILDING, number),
            metres=1.0,
            at=(x, y),
            yaw=foot.yaw,
        )
    if rise > 2.2:
        for share in rng.uniform(0.15, 0.8, rng.integers(0, 3)):
            _dormer(m, foot, eaves, rise, share, tint, number)
    gutter = (wide[0] + foot.inward * 0.05, wide[1] + foot.inward * 0.05)
    tube(
        m,
        (*gutter[0], eaves - drop),
        (*gutter[1], eaves - drop),
        (0.07, 0.07),
        Appearance(Material.METAL, BUILDING, number),
        sides=5,
    )


def _dormer(m: MeshBuilder, foot: Footprint, eaves: float, rise: float, share: float, tint: F64, number: int) -> None:
    """A box with a window that stands out of the front slope."""
    depth = foot.depth_m
    at = foot.p + foot.along * foot.width_m * share + foot.inward * depth * 0.14
    low, high = eaves + rise * 0.22, eaves + rise * 0.22 + 1.35
    box(
        m,
        (0, 0, low),
        (1.5, depth * 0.3, high),
        Appearance(Material.CONCRETE, BUILDING, number, tint * 1.3),
        at=(at[0], at[1]),
        yaw=foot.yaw,
    )
    box(
        m,
        (0.25, -0.04, low + 0.25),
        (1.25, 0, high - 0.15),
        Appearance(Material.GLASS, BUILDING, number),
        at=(at[0], at[1]),
        yaw=foot.yaw,
    )
    box(
        m,
        (-0.15, -0.2, high),
        (1.65, depth * 0.3, high + 0.12),
        Appearance(Material.METAL, BUILDING, number),
        at=(at[0], at[1]),
        yaw=foot.yaw,
    )


def _balconies(m: MeshBuilder, foot: Footprint, first_z: float, floors: int, number: int, rng: np.random.Generator) -> None:
    """Slabs with railings in the same bays on every floor."""
    bays = max(1, round(foot.width_m / BAY_M))
    pitch = foot.width_m / bays
    chosen = [b for b in range(bays) if rng.random() < 0.35]
    solid = rng.random() < 0.4
    for f in range(floors):
        z = first_z + f * FLOOR_M
        if z < 2.6:
            continue
        for b in chosen:
            at = foot.p + foot.along * (pitch * b + pitch / 2 - 1.15)
            place = (float(at[0]), float(at[1]))
            box(
                m,
                (0, -1.1, z),
                (2.3, 0, z + 0.16),
                Appearance(Material.CONCRETE, BUILDING, number),
                at=place,
                yaw=foot.yaw,
                bottom=True,
            )
            if solid:
                box(
                    m,
                    (0, -1.1, z + 0.16),
                    (2.3, -1.04, z + 1.0),
                    Appearance(Material.CONCRETE, BUILDING, number, (1.3, 1.3, 1.25)),
                    at=place,
                    yaw=foot.yaw,
                )
                continue
            c, s = np.cos(foot.yaw), np.sin(foot.yaw)
            a, d = at + 1.08 * np.array([s, -c]), foot.along * 2.3
            quad = [(*a, z + 0.16), (*(a + d), z + 0.16), (*(a + d), z + 1.05), (*a, z + 1.05)]
            m.quads([quad], [[(0, 1), (1.15, 1), (1.15, 0), (0, 0)]], Material.RAILS, BUILDING, number)


def _front(rng: np.random.Generator, styles: tuple[Material, ...], repaint: np.random.Generator | None) -> tuple[Material, F64]:
    """Material and tint of a house's front; with `repaint`, others than rng gives, which goes on as ever."""
    chosen, tints = int(rng.integers(len(styles))), rng.uniform((0.75, 0.94, 0.88), (1.1, 1.03, 1.05))
    if repaint is not None:
        chosen = (chosen + int(repaint.integers(1, len(styles)))) % len(styles)
        tints = repaint.uniform((0.5, 0.85, 0.7), (1.2, 1.1, 1.1))
    return styles[chosen], tints[0] * np.array([1.0, tints[1], tints[2]])


def town_house(
    m: MeshBuilder, foot: Footprint, floors: int, number: int, rng: np.random.Generator, repaint: np.random.Generator | None = None
) -> None:
    """A house of a closed row: shop or door at the foot, fronts of windows, balconies, cornice, roof. See `_front` for repaint."""
    style, tint = _front(rng, FACADES, repaint)
    base = SHOP_M if rng.random() < 0.35 else 0.5
    top = base + floors * FLOOR_M
    _walls(m, foot, (base, top), style, style, tint, number, float(rng.integers(BAYS)) / BAYS)
    _walls(m, foot, (FOOT_M, base), Material.CONCRETE, Material.CONCRETE, tint, number, 0.0)
    out = -foot.inward
    if base == SHOP_M:
        a, b = foot.p + out * 0.02, foot.q + out * 0.02
        repeat = max(1, round(foot.width_m / 4)) / 3
        m.quads(
            [[(*a, 0.0), (*b, 0.0), (*b, base), (*a, base)]],
            [[(0, 1), (repeat, 1), (repeat, 0), (0, 0)]],
            Material.SHOP,
            BUILDING,
            number,
        )
        if rng.random() < 0.5:
            _awning(m, foot, number, rng)
    else:
        _door(m, foot, foot.width_m * rng.uniform(0.2, 0.7), number)
    if rng.random() < 0.55:
        _balconies(m, foot, base + 0.15, floors, number, rng)
    box(
        m,
        (-0.02, -0.28, top - 0.32),
        (foot.width_m + 0.02, 0.0, top),
        Appearance(Material.CONCRETE, BUILDING, number, tint * 1.2),
        at=(foot.p[0], foot.p[1]),
        yaw=foot.yaw,
        bottom=True,
    )
    pipe = foot.p + foot.along * 0.2 + out * 0.07
    tube(m, (*pipe, 0.0), (*pipe, top), (0.05, 0.05), Appearance(Material.METAL, BUILDING, number), sides=5)
    if rng.random() < 0.7:
        roof_tint = rng.uniform(0.6, 1.15) * np.array([1.0, rng.uniform(0.9, 1.6), rng.uniform(0.9, 2.0)])
        _gable_roof(m, foot, top, foot.depth_m * rng.uniform(0.25, 0.42), tint, roof_tint, number, rng)
    else:
        c = foot.corners()
        uv = [(0, 0), (foot.width_m / 4, 0), (foot.width_m / 4, foot.depth_m / 4), (0, foot.depth_m / 4)]
        m.quads([np.column_stack([c, np.full(4, top)])], [uv], Material.CONCRETE, BUILDING, number)


def _door(m: MeshBuilder, foot: Footprint, offset: float, number: int) -> None:
    """A house door with two steps."""
    a = foot.p + foot.along * offset - foot.inward * 0.03
    b = a + foot.along * 1.15
    m.quads([[(*a, 0.25), (*b, 0.25), (*b, 2.55), (*a, 2.55)]], [[(0, 1), (1, 1), (1, 0), (0, 0)]], Material.DOOR, BUILDING, number)
    box(m, (-0.2, -0.45, -0.1), (1.35, 0.0, 0.25), Appearance(Material.CONCRETE, BUILDING, number), at=(a[0], a[1]), yaw=foot.yaw)


def _awning(m: MeshBuilder, foot: Footprint, number: int, rng: np.random.Generator) -> None:
    """A cloth roof over the shop window."""
    tint = ((0.5, 0.08, 0.06), (0.08, 0.25, 0.12), (0.7, 0.65, 0.5), (0.08, 0.1, 0.3))[rng.integers(4)]
    a, b = foot.p + foot.along * 0.6, foot.q - foot.along * 0.6
    out = -foot.inward * 1.3
    quad = [(*(a + out), 2.25), (*(b + out), 2.25), (*b, 2.85), (*a, 2.85)]
    m.quads([quad], [[(0, 1), (3, 1), (3, 0), (0, 0)]], Material.CLOTH, BUILDING, number, tint)


def detached_house(
    m: MeshBuilder, foot: Footprint, floors: int, number: int, rng: np.random.Generator, repaint: np.random.Generator | None = None
) -> None:
    """A family house: one or two floors and a steep roof. See `_front` for repaint."""
    style, tint = _front(rng, FAMILY_FRONTS, repaint)
    top = 0.4 + floors * FLOOR_M
    _walls(m, foot, (0.4, top), style, style, tint, number, float(rng.integers(BAYS)) / BAYS)
    _walls(m, foot, (FOOT_M, 0.4), Material.CONCRETE, Material.CONCRETE, tint, number, 0.0)
    _door(m, foot, foot.width_m * 0.42, number)
    roof_tint = rng.uniform(0.55, 1.2) * np.array([1.0, rng.uniform(0.9, 1.7), rng.uniform(0.9, 2.2)])
    _gable_roof(m, foot, top, foot.depth_m * rng.uniform(0.38, 0.55), tint, roof_tint, number, rng)


def monument(m: MeshBuilder, at: F64, number: int) -> None:
    """A stone pillar with a ball on three steps."""
    place = (float(at[0]), float(at[1]))
    for k, half in enumerate((1.5, 1.1, 0.7)):
        box(
            m,
            (-half, -half, 0.3),
            (half, half, 0.75 + 0.22 * k),
            Appearance(Material.CONCRETE, BUILDING, number, STONE),
            4.0,
            place,
        )
    box(m, (-0.35, -0.35, 1.1), (0.35, 0.35, 4.2), Appearance(Material.CONCRETE, BUILDING, number, STONE), 4.0, place)
    box(m, (-0.45, -0.45, 4.2), (0.45, 0.45, 4.4), Appearance(Material.CONCRETE, BUILDING, number), at=place, bottom=True)
    angles = np.linspace(-np.pi / 2, np.pi / 2, 7)
    for low, high in pairwise(angles):
        z, radii = 4.9 + 0.5 * np.sin([low, high]), 0.5 * np.cos([low, high])
        tube(m, (*at, z[0]), (*at, z[1]), (radii[0], radii[1]), Appearance(Material.METAL, BUILDING, number, (1.4, 1.2, 0.6)), 10)
