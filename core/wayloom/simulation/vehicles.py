"""Lorries, buses, trams and two-wheelers, modelled around their own origin: x forward, y left, wheels on z = 0.

PAINTWORK marks what is recoloured. Passenger cars have a module of their own, and are named here too.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.cars import (
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
from wayloom.simulation.materials import Material
from wayloom.simulation.mesh import Mesh, MeshBuilder, recoloured
from wayloom.simulation.solids import box, disc, tube

__all__ = ["CAR_COLOURS", "CAR_PROFILES", "PAINTWORK", "bicycle", "braking", "bus", "car", "lorry", "motorcycle", "two_wheeler"]

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
    box(m, (back + 0.01, -half + 0.01, low), (front, half - 0.01, high), Material.PAINT, cls, 0, BODY_COLOURS[0], 3, bottom=True)
    for y in (half, -half):
        _flank(m, (back, front), y, (low, high), Material.TRUCK_SIDE, cls, BODY_COLOURS[0])
    _face(m, back, half, (low, high), -1.0, Material.TRUCK_BACK, cls, BODY_COLOURS[0])
    box(m, (back, -0.45, 0.62), (3.1, 0.45, low), Material.METAL, cls, 0, DARK_STEEL, 2, bottom=True)
    cab: Outline = ((1.90, 0.55), (1.90, 2.75), (2.35, 2.98), (2.95, 2.92), (3.62, 1.62), (3.72, 1.0), (3.70, 0.45))
    _lofted(m, cab, 1.18, frozenset({3}), cls)
    _face(m, 3.735, 1.16, (0.45, 1.62), 1.0, Material.CAB_FRONT, cls)
    for way in (1.0, -1.0):
        _lorry_side(m, way, cls)
    box(m, (back - 0.03, -1.15, 0.45), (back + 0.05, 1.15, 0.58), Material.METAL, cls, 0, STEEL)
    for y in (0.95, -0.95):
        box(m, (back - 0.05, y - 0.2, 0.70), (back + 0.04, y + 0.2, 0.92), Material.LIT, cls, 0, TAIL_LAMP)
        box(m, (3.70, y - 0.17, 0.62), (3.76, y + 0.17, 0.84), Material.PAINT, cls, 0, WHITE_LAMP)
    box(m, (back - 0.04, -0.26, 0.60), (back, 0.26, 0.72), Material.PAINT, cls, 0, (0.7, 0.55, 0.1))
    return m.build()


def _lorry_side(m: MeshBuilder, way: float, cls: int) -> None:
    """Cab window, door gap, mirror, side guard, tank, wheels and mudguards of one side."""
    y = way * 1.19
    window = [(2.05, y, 1.72), (3.28, y, 1.72), (2.98, y, 2.60), (2.05, y, 2.60)]
    m.quads([window if way < 0 else window[::-1]], [[(0, 1), (1, 1), (1, 0), (0, 0)]], Material.GLASS, cls)
    lo, hi = sorted((way * 1.2, way * 1.42))
    box(m, (3.35, lo, 1.75), (3.50, hi, 2.35), Material.PAINT, cls, 0, RUBBER, bottom=True)
    lo, hi = sorted((way * 1.14, way * 1.2))
    for z in (0.50, 0.74):
        box(m, (-1.9, lo, z), (1.1, hi, z + 0.13), Material.METAL, cls, 0, STEEL, bottom=True)
    lo, hi = sorted((way * 0.6, way * 1.12))
    box(m, (0.1, lo, 0.45), (1.4, hi, 0.95), Material.METAL, cls, 0, (0.9, 0.9, 0.9), 1, bottom=True)
    lo, hi = sorted((way * 0.85, way * 1.21))
    for x in (-3.4, -2.3, 2.72):
        wheel(m, x, way * 1.2, 0.48, cls)
        box(m, (x - 0.56, lo, 1.0), (x + 0.56, hi, 1.05), Material.PAINT, cls, 0, RUBBER, bottom=True)
    disc(m, (2.72, way * 1.182, 0.52), 0.62, Material.PAINT, cls, way, tint=(0.01, 0.01, 0.01))


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
            disc(m, (x, y + np.sign(y) * 0.006, 0.52), 0.60, Material.PAINT, cls, float(np.sign(y)), tint=(0.01, 0.01, 0.01))
            wheel(m, x, y + np.sign(y) * 0.012, 0.48, cls)
        lo, hi = sorted((y, y * 1.17))
        box(m, (x1 - 0.05, lo, 2.1), (x1 + 0.18, hi, 2.5), Material.PAINT, cls, 0, RUBBER, bottom=True)
    _face(m, x0 - 0.01, half, (low, high - 0.05), -1.0, Material.BUS_BACK, cls)
    _face(m, x1 + 0.01, half, (low, high - 0.05), 1.0, Material.BUS_FRONT, cls)
    for y in (1.04, -1.04):
        box(m, (x0 - 0.03, y - 0.12, 0.85), (x0 + 0.02, y + 0.12, 1.12), Material.LIT, cls, 0, TAIL_LAMP)
    box(m, (-2.5, -0.8, high), (1.0, 0.8, high + 0.22), Material.PAINT, cls, 0, BODY_COLOURS[1], 3)
    return m.build()


def _tram(length: float) -> Mesh:
    """Sections joined by bellows, slanted fronts at both ends, gear and a pantograph on the roof."""
    m, cls = MeshBuilder(), CLASS_ID["train"]
    half, low, high, gap, nose = 1.22, 0.28, 3.35, 0.35, 0.55
    x0, x1 = -length / 2, length / 2
    for a, b in ((x0 + nose, -gap), (gap, x1 - nose)):
        box(m, (a, -half + 0.01, low), (b, half - 0.01, high), Material.PAINT, cls, 0, PAINTWORK, 3, bottom=True)
        for y in (half, -half):
            _flank(m, (a, b), y, (low, high), Material.TRAM_SIDE, cls)
        box(m, (a + 1.2, -0.85, high), (b - 1.0, 0.85, high + 0.32), Material.METAL, cls, 0, STEEL, 3)
    box(m, (-gap, -half + 0.12, low + 0.1), (gap, half - 0.12, high - 0.1), Material.CLOTH, cls, 0, (0.05, 0.05, 0.05), 0.25)
    for way in (1.0, -1.0):
        tip, base = way * x1, way * (x1 - nose)
        outline: Outline = ((base, low), (base, high), (tip - way * 0.3, high - 0.1), (tip, 1.5), (tip, low))
        _lofted(m, outline if way > 0 else outline[::-1], half - 0.06, frozenset(), cls)
        _slanted_face(m, (tip + 0.012 * way, tip - way * 0.33), half - 0.08, (low, high - 0.12), way, cls)
        for y in (0.85, -0.85):
            box(m, (tip - 0.04, y - 0.16, 0.85), (tip + 0.04, y + 0.16, 1.05), Material.PAINT, cls, 0, WHITE_LAMP)
    box(m, (x0 + 1, -1.0, 0.06), (x1 - 1, 1.0, low), Material.PAINT, cls, 0, RUBBER)
    for y in (-0.5, 0.5):
        elbow = (-0.6, y, high + 1.0)
        for end in ((-1.8, y, high + 0.3), (-1.7, y, high + 1.9)):
            tube(m, end, elbow, (0.035, 0.035), Material.METAL, cls, 0, STEEL, 4)
    tube(m, (-1.7, -0.8, high + 1.9), (-1.7, 0.8, high + 1.9), (0.04, 0.04), Material.METAL, cls, 0, STEEL, 4)
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


def two_wheeler(
    frame: np.ndarray, wheel_x: tuple[float, float], radius: float, class_id: int, tint: tuple[float, ...], thick: float
) -> Mesh:
    """Two wheels and the bars of a frame (N, 2, 3) m."""
    m = MeshBuilder()
    solid = thick > 0.03  # a motorcycle's wheel
    tyre = 0.06 if solid else 0.026
    for x in wheel_x:
        if solid:
            for side in (1.0, -1.0):
                disc(m, (x, side * tyre, radius), radius, Material.WHEEL, class_id, side)
        else:
            disc(m, (x, 0.0, radius), radius / 0.94, Material.SPOKES, class_id, 1.0, 16)
        ends = ((x, -tyre, radius), (x, tyre, radius))
        tube(m, *ends, (radius, radius), Material.PAINT, class_id, 0, (0.03, 0.03, 0.03), 16)
    for a, b in frame:
        tube(m, a, b, (thick, thick), Material.PAINT, class_id, 0, tint, 5)
    return m.build()


def bicycle() -> Mesh:
    """A city bicycle with saddle, mudguards, rack, basket, lamps and pedals."""
    cls = CLASS_ID["bicycle"]
    bars = np.array(
        [
            [(-0.52, 0, 0.34), (0.0, 0, 0.32)],
            [(0.0, 0, 0.32), (0.38, 0, 0.80)],
            [(0.52, 0, 0.34), (0.36, 0, 1.02)],
            [(-0.17, 0, 0.92), (0.0, 0, 0.32)],
            [(-0.14, 0, 0.80), (0.40, 0, 0.84)],
            [(-0.52, 0, 0.34), (-0.14, 0, 0.78)],
            [(0.33, -0.26, 1.03), (0.33, 0.26, 1.03)],
            [(0.0, 0.0, 0.32), (0.12, 0.10, 0.20)],
            [(0.0, 0.0, 0.32), (-0.12, -0.10, 0.44)],
        ]
    )
    m = MeshBuilder()
    m.add(two_wheeler(bars, (-0.52, 0.52), 0.35, cls, PAINTWORK, 0.028))
    dark = (0.03, 0.03, 0.03)
    box(m, (-0.34, -0.10, 0.91), (-0.06, 0.10, 0.97), Material.CLOTH, cls, 0, dark, bottom=True)
    box(m, (-0.78, -0.07, 0.74), (-0.24, 0.07, 0.76), Material.METAL, cls, 0, STEEL, bottom=True)
    for x, way in ((-0.52, -1.0), (0.52, 1.0)):
        angle = np.linspace(0.15, 0.85, 5) * np.pi
        arc = np.column_stack([x - 0.37 * np.cos(angle) * way, np.zeros(5), 0.34 + 0.37 * np.sin(angle)])
        for a, b in pairwise(arc):
            tube(m, a, b, (0.03, 0.03), Material.PAINT, cls, 0, PAINTWORK, 4)
    box(m, (0.42, -0.17, 0.86), (0.70, 0.17, 1.06), Material.PICKETS, cls, 0, dark, 0.5)
    box(m, (-0.80, -0.04, 0.62), (-0.76, 0.04, 0.70), Material.LIT, cls, 0, TAIL_LAMP)
    box(m, (0.40, -0.04, 0.78), (0.46, 0.04, 0.86), Material.PAINT, cls, 0, WHITE_LAMP)
    for y in (0.11, -0.11):  # panniers
        box(m, (-0.72, y - 0.05, 0.46), (-0.44, y + 0.05, 0.74), Material.CLOTH, cls, 0, (0.16, 0.14, 0.12), 0.6, bottom=True)
    box(m, (-0.50, -0.045, 0.27), (0.10, -0.035, 0.38), Material.PAINT, cls, 0, dark)
    for y, x, z in ((0.13, 0.12, 0.18), (-0.13, -0.12, 0.42)):
        box(m, (x - 0.05, y - 0.05, z), (x + 0.05, y + 0.05, z + 0.03), Material.PAINT, cls, 0, dark, bottom=True)
    return m.build()


def motorcycle() -> Mesh:
    """A motorcycle with fairing, tank, seat, engine, exhaust, mudguards, mirrors, plate and lamps."""
    cls, dark = CLASS_ID["motorcycle"], (0.04, 0.04, 0.04)
    bars = np.array(
        [
            [(0.72, 0.08, 0.32), (0.45, 0.08, 1.0)],
            [(0.72, -0.08, 0.32), (0.45, -0.08, 1.0)],
            [(0.42, -0.38, 1.06), (0.42, 0.38, 1.06)],
            [(-0.68, 0.1, 0.32), (0.0, 0.1, 0.45)],
            [(-0.68, -0.1, 0.32), (0.0, -0.1, 0.45)],
            [(0.40, 0.24, 1.05), (0.48, 0.34, 1.26)],
            [(0.40, -0.24, 1.05), (0.48, -0.34, 1.26)],
        ]
    )
    m = MeshBuilder()
    m.add(two_wheeler(bars, (-0.68, 0.72), 0.31, cls, (0.1, 0.1, 0.1), 0.035))
    box(m, (-0.25, -0.19, 0.26), (0.34, 0.19, 0.66), Material.METAL, cls, 0, (0.5, 0.5, 0.5), 0.4, bottom=True)
    tank = [((0.42, 0, 0.86), (0.18, 0, 0.92), 0.10, 0.20), ((0.18, 0, 0.92), (-0.10, 0, 0.86), 0.20, 0.13)]
    for a, b, r0, r1 in tank:
        tube(m, a, b, (r0, r1), Material.PAINT, cls, 0, PAINTWORK, 10, 1.0)
    for a, b, r0, r1 in (((-0.08, 0, 0.84), (-0.5, 0, 0.84), 0.15, 0.17), ((-0.5, 0, 0.84), (-0.9, 0, 0.90), 0.16, 0.10)):
        tube(m, a, b, (r0, r1), Material.CLOTH, cls, 0, dark, 8, 0.8, 0.55)
    tube(m, (-0.55, 0, 0.76), (-0.98, 0, 0.84), (0.13, 0.07), Material.PAINT, cls, 0, PAINTWORK, 8)
    tube(m, (0.50, 0, 0.95), (0.66, 0, 0.92), (0.20, 0.13), Material.PAINT, cls, 0, PAINTWORK, 10)
    box(m, (0.64, -0.11, 0.84), (0.69, 0.11, 1.0), Material.PAINT, cls, 0, WHITE_LAMP)
    screen = [(0.50, 0.17, 1.08), (0.50, -0.17, 1.08), (0.36, -0.13, 1.32), (0.36, 0.13, 1.32)]
    m.quads([screen[::-1]], [[(0, 1), (1, 1), (1, 0), (0, 0)]], Material.GLASS, cls)
    tube(m, (0.0, -0.20, 0.34), (-0.85, -0.24, 0.46), (0.05, 0.075), Material.METAL, cls, 0, (0.8, 0.8, 0.8), 8)
    for x in (0.72, -0.68):
        box(m, (x - 0.22, -0.08, 0.63), (x + 0.22, 0.08, 0.665), Material.PAINT, cls, 0, PAINTWORK, bottom=True)
    for y in (0.34, -0.34):
        box(m, (0.46, y - 0.09, 1.22), (0.50, y + 0.09, 1.33), Material.PAINT, cls, 0, dark, bottom=True)
    box(m, (-1.02, -0.11, 0.60), (-0.99, 0.11, 0.72), Material.PAINT, cls, 0, (0.75, 0.75, 0.72))
    box(m, (-1.02, -0.10, 0.76), (-0.96, 0.10, 0.86), Material.LIT, cls, 0, TAIL_LAMP)
    return m.build()
