"""Lorry, bus and tram models around their own origin: x forward, y left, wheels on z = 0.

PAINTWORK marks what is recoloured. Passenger cars have a module of their own, and are named here too.
"""

import numpy as np
from numpy.typing import ArrayLike

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.models.cars import (
    BRAKE_LAMP,
    CAR_PROFILES,
    PAINTWORK,
    RUBBER,
    TAIL_LAMP,
    WHITE,
    WHITE_LAMP,
    car,
    wheel,
)
from wayloom.simulation.models.mesh import Mesh, MeshBuilder, recoloured
from wayloom.simulation.models.solids import Appearance, box, disc, tube
from wayloom.simulation.textures.materials import Material

__all__ = ["CAR_COLOURS", "CAR_PROFILES", "PAINTWORK", "braking", "bus", "car", "lorry"]

CAR_COLOURS = (
    (0.55, 0.56, 0.58), (0.03, 0.03, 0.035), (0.78, 0.78, 0.76), (0.03, 0.06, 0.2), (0.32, 0.03, 0.03), (0.14, 0.15, 0.17),
    (0.12, 0.2, 0.14), (0.30, 0.29, 0.27), (0.05, 0.13, 0.28), (0.02, 0.02, 0.02),
)  # fmt: skip
BODY_COLOURS = ((0.85, 0.85, 0.83), (0.75, 0.74, 0.70))
STEEL, DARK_STEEL = (0.4, 0.4, 0.4), (0.13, 0.13, 0.13)
Outline = tuple[tuple[float, float], ...]


def braking(mesh: Mesh) -> Mesh:
    """The vehicle with its rear lamps lit."""
    return recoloured(mesh, TAIL_LAMP, BRAKE_LAMP)


def _face(
    m: MeshBuilder,
    x: float,
    half: float,
    z: tuple[float, float],
    way: float,
    material: Material,
    cls: int,
    tint: ArrayLike = PAINTWORK,
) -> None:
    """An upright quad across x that looks forward (way +1) or back (-1), its texture the right way round."""
    corners = [(x, half, z[0]), (x, -half, z[0]), (x, -half, z[1]), (x, half, z[1])]
    if way > 0:
        corners = [corners[k] for k in (1, 0, 3, 2)]
    m.quads([corners], [[(0, 1), (1, 1), (1, 0), (0, 0)]], material, cls, 0, tint)


def _flank(
    m: MeshBuilder,
    x: tuple[float, float],
    y: float,
    z: tuple[float, float],
    material: Material,
    cls: int,
    tint: ArrayLike = PAINTWORK,
) -> None:
    """An upright quad along x at y, its texture running from back to front on both sides."""
    corners = [(x[0], y, z[0]), (x[1], y, z[0]), (x[1], y, z[1]), (x[0], y, z[1])]
    uv = [(0, 1), (1, 1), (1, 0), (0, 0)]
    if y > 0:  # counter-clockwise as seen from the left
        corners, uv = corners[::-1], uv[::-1]
    m.quads([corners], [uv], material, cls, 0, tint)


def _lofted(m: MeshBuilder, outline: Outline, half: float, glass: frozenset[int], cls: int) -> None:
    """A body of constant width: an outline (x, z) from low at the back over the top to low at the front; sides are paint."""
    p = np.array(outline)
    for k in range(len(p) - 1):
        (xa, za), (xb, zb) = p[k], p[k + 1]
        corners = [(xa, half, za), (xa, -half, za), (xb, -half, zb), (xb, half, zb)]
        material, tint = (Material.GLASS, WHITE) if k in glass else (Material.PAINT, PAINTWORK)
        m.quads([corners], [[(xa / 2, 0), (xa / 2, 1), (xb / 2, 1), (xb / 2, 0)]], material, cls, 0, tint)
    middle = p.mean(axis=0)
    for y in (half, -half):
        for k in range(len(p)):
            a, b = p[k], p[(k + 1) % len(p)]
            ring = [(*middle, y), (*a, y), (*b, y), (*b, y)] if y < 0 else [(*middle, y), (*b, y), (*a, y), (*a, y)]
            corners = [(x, way, z) for x, z, way in ring]
            uv = [(x / 2, z / 2) for x, z, _ in ring]
            m.quads([corners], [uv], Material.PAINT, cls, 0, PAINTWORK, [[(0.0, np.sign(y), 0.0)] * 4])


def lorry() -> Mesh:
    """A three-axle lorry of 8 m: curtain-sided box, cab with slanted windscreen, side guards, tanks, mudguards."""
    m, cls = MeshBuilder(), CLASS_ID["truck"]
    back, front, low, high, half = -4.2, 1.75, 1.02, 3.55, 1.24
    box(
        m,
        (back + 0.01, -half + 0.01, low),
        (front, half - 0.01, high),
        Appearance(Material.PAINT, cls, 0, BODY_COLOURS[0]),
        3,
        bottom=True,
    )
    for y in (half, -half):
        _flank(m, (back, front), y, (low, high), Material.TRUCK_SIDE, cls, BODY_COLOURS[0])
    _face(m, back, half, (low, high), -1.0, Material.TRUCK_BACK, cls, BODY_COLOURS[0])
    box(m, (back, -0.45, 0.62), (3.1, 0.45, low), Appearance(Material.METAL, cls, 0, DARK_STEEL), 2, bottom=True)
    cab: Outline = ((1.90, 0.55), (1.90, 2.75), (2.35, 2.98), (2.95, 2.92), (3.62, 1.62), (3.72, 1.0), (3.70, 0.45))
    _lofted(m, cab, 1.18, frozenset({3}), cls)
    _face(m, 3.735, 1.16, (0.45, 1.62), 1.0, Material.CAB_FRONT, cls)
    for way in (1.0, -1.0):
        _lorry_side(m, way, cls)
    box(m, (back - 0.03, -1.15, 0.45), (back + 0.05, 1.15, 0.58), Appearance(Material.METAL, cls, 0, STEEL))
    for y in (0.95, -0.95):
        box(m, (back - 0.05, y - 0.2, 0.70), (back + 0.04, y + 0.2, 0.92), Appearance(Material.LIT, cls, 0, TAIL_LAMP))
        box(m, (3.70, y - 0.17, 0.62), (3.76, y + 0.17, 0.84), Appearance(Material.PAINT, cls, 0, WHITE_LAMP))
    box(m, (back - 0.04, -0.26, 0.60), (back, 0.26, 0.72), Appearance(Material.PAINT, cls, 0, (0.7, 0.55, 0.1)))
    return m.build()


def _lorry_side(m: MeshBuilder, way: float, cls: int) -> None:
    """Cab window, door gap, mirror, side guard, tank, wheels and mudguards of one side."""
    y = way * 1.19
    window = [(2.05, y, 1.72), (3.28, y, 1.72), (2.98, y, 2.60), (2.05, y, 2.60)]
    m.quads([window if way < 0 else window[::-1]], [[(0, 1), (1, 1), (1, 0), (0, 0)]], Material.GLASS, cls)
    lo, hi = sorted((way * 1.2, way * 1.42))
    box(m, (3.35, lo, 1.75), (3.50, hi, 2.35), Appearance(Material.PAINT, cls, 0, RUBBER), bottom=True)
    lo, hi = sorted((way * 1.14, way * 1.2))
    for z in (0.50, 0.74):
        box(m, (-1.9, lo, z), (1.1, hi, z + 0.13), Appearance(Material.METAL, cls, 0, STEEL), bottom=True)
    lo, hi = sorted((way * 0.6, way * 1.12))
    box(m, (0.1, lo, 0.45), (1.4, hi, 0.95), Appearance(Material.METAL, cls, 0, (0.9, 0.9, 0.9)), 1, bottom=True)
    lo, hi = sorted((way * 0.85, way * 1.21))
    for x in (-3.4, -2.3, 2.72):
        wheel(m, x, way * 1.2, 0.48, cls)
        box(m, (x - 0.56, lo, 1.0), (x + 0.56, hi, 1.05), Appearance(Material.PAINT, cls, 0, RUBBER), bottom=True)
    disc(m, (2.72, way * 1.182, 0.52), 0.62, Appearance(Material.PAINT, cls, tint=(0.01, 0.01, 0.01)), way)


def bus(length: float = 11.5, class_name: str = "bus") -> Mesh:
    """A city bus, or, with class "train", a tram of two sections."""
    return _tram(length) if class_name == "train" else _bus(length)


def _bus(length: float) -> Mesh:
    m, cls = MeshBuilder(), CLASS_ID["bus"]
    half, x0, x1, low, high = 1.26, -length / 2, length / 2, 0.30, 3.05
    shell: Outline = ((x0, low), (x0, high - 0.12), (x0 + 0.15, high), (x1 - 0.3, high), (x1 - 0.05, high - 0.25), (x1, low))
    _lofted(m, shell, half - 0.01, frozenset(), cls)
    for y in (half, -half):
        _flank(m, (x0, x1 - 0.06), y, (low, high), Material.BUS_SIDE, cls)
        for x in (x0 + 2.6, x1 - 2.5):
            disc(
                m,
                (x, y + np.sign(y) * 0.006, 0.52),
                0.60,
                Appearance(Material.PAINT, cls, tint=(0.01, 0.01, 0.01)),
                float(np.sign(y)),
            )
            wheel(m, x, y + np.sign(y) * 0.012, 0.48, cls)
        lo, hi = sorted((y, y * 1.17))
        box(m, (x1 - 0.05, lo, 2.1), (x1 + 0.18, hi, 2.5), Appearance(Material.PAINT, cls, 0, RUBBER), bottom=True)
    _face(m, x0 - 0.01, half, (low, high - 0.05), -1.0, Material.BUS_BACK, cls)
    _face(m, x1 + 0.01, half, (low, high - 0.05), 1.0, Material.BUS_FRONT, cls)
    for y in (1.04, -1.04):
        box(m, (x0 - 0.03, y - 0.12, 0.85), (x0 + 0.02, y + 0.12, 1.12), Appearance(Material.LIT, cls, 0, TAIL_LAMP))
    box(m, (-2.5, -0.8, high), (1.0, 0.8, high + 0.22), Appearance(Material.PAINT, cls, 0, BODY_COLOURS[1]), 3)
    return m.build()


def _tram(length: float) -> Mesh:
    """Sections joined by bellows, slanted fronts at both ends, gear and a pantograph on the roof."""
    m, cls = MeshBuilder(), CLASS_ID["train"]
    half, low, high, gap, nose = 1.22, 0.28, 3.35, 0.35, 0.55
    x0, x1 = -length / 2, length / 2
    for a, b in ((x0 + nose, -gap), (gap, x1 - nose)):
        box(m, (a, -half + 0.01, low), (b, half - 0.01, high), Appearance(Material.PAINT, cls, 0, PAINTWORK), 3, bottom=True)
        for y in (half, -half):
            _flank(m, (a, b), y, (low, high), Material.TRAM_SIDE, cls)
        box(m, (a + 1.2, -0.85, high), (b - 1.0, 0.85, high + 0.32), Appearance(Material.METAL, cls, 0, STEEL), 3)
    box(
        m,
        (-gap, -half + 0.12, low + 0.1),
        (gap, half - 0.12, high - 0.1),
        Appearance(Material.CLOTH, cls, 0, (0.05, 0.05, 0.05)),
        0.25,
    )
    for way in (1.0, -1.0):
        tip, base = way * x1, way * (x1 - nose)
        outline: Outline = ((base, low), (base, high), (tip - way * 0.3, high - 0.1), (tip, 1.5), (tip, low))
        _lofted(m, outline if way > 0 else outline[::-1], half - 0.06, frozenset(), cls)
        _slanted_face(m, (tip + 0.015 * way, tip - way * 0.275), half - 0.08, (low, high - 0.12), way, cls)
        for y in (0.85, -0.85):
            box(m, (tip - 0.04, y - 0.16, 0.85), (tip + 0.04, y + 0.16, 1.05), Appearance(Material.PAINT, cls, 0, WHITE_LAMP))
    box(m, (x0 + 1, -1.0, 0.06), (x1 - 1, 1.0, low), Appearance(Material.PAINT, cls, 0, RUBBER))
    for y in (-0.5, 0.5):
        elbow = (-0.6, y, high + 1.0)
        for end in ((-1.8, y, high + 0.3), (-1.7, y, high + 1.9)):
            tube(m, end, elbow, (0.035, 0.035), Appearance(Material.METAL, cls, 0, STEEL), 4)
    tube(m, (-1.7, -0.8, high + 1.9), (-1.7, 0.8, high + 1.9), (0.04, 0.04), Appearance(Material.METAL, cls, 0, STEEL), 4)
    return m.build()


def _slanted_face(m: MeshBuilder, x: tuple[float, float], half: float, z: tuple[float, float], way: float, cls: int) -> None:
    """A tram's face: upright to half its height, then leaning back; x at foot and top, m."""
    middle = 1.5
    share = (middle - z[0]) / (z[1] - z[0])
    for (xa, za, va), (xb, zb, vb) in (
        ((x[0], z[0], 1.0), (x[0], middle, 1 - share)),
        ((x[0], middle, 1 - share), (x[1], z[1], 0.0)),
    ):
        left, right = (half, -half) if way < 0 else (-half, half)
        corners = [(xa, left, za), (xa, right, za), (xb, right, zb), (xb, left, zb)]
        m.quads([corners], [[(0, va), (1, va), (1, vb), (0, vb)]], Material.BUS_FRONT, cls, 0, PAINTWORK)
