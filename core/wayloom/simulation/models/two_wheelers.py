"""Bicycle, motorcycle and scooter models around their own origin: x forward, y left, wheels on z = 0."""

from itertools import pairwise

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.models.cars import PAINTWORK, TAIL_LAMP, WHITE_LAMP
from wayloom.simulation.models.mesh import Mesh, MeshBuilder
from wayloom.simulation.models.solids import Appearance, box, disc, lathe, tube
from wayloom.simulation.textures.materials import Material

STEEL, CHROME, ALLOY = (0.4, 0.4, 0.4), (0.85, 0.85, 0.85), (0.55, 0.55, 0.56)
DARK, BLACK, TYRE = (0.03, 0.03, 0.03), (0.018, 0.018, 0.02), (0.028, 0.028, 0.028)
AMBER, PLATE = (0.75, 0.30, 0.02), (0.62, 0.62, 0.60)
WHEEL_SIDES, WHEEL_SPOKES = 18, 5
Point = tuple[float, float, float]
FRAME: tuple[tuple[Point, Point, float], ...] = (
    ((0.43, 0.05, 0.88), (0.30, 0.14, 0.34), 0.022), ((0.43, 0.05, 0.92), (-0.12, 0.15, 0.66), 0.024),
    ((-0.12, 0.15, 0.66), (-0.16, 0.13, 0.30), 0.026), ((-0.12, 0.13, 0.66), (-0.66, 0.10, 0.78), 0.016),
    ((-0.15, 0.13, 0.36), (-0.68, 0.125, 0.31), 0.030), ((0.30, 0.14, 0.34), (-0.16, 0.13, 0.26), 0.018),
)  # fmt: skip
"""Left half of a motorcycle's frame and swing arm: the ends of its tubes and their radius, m."""
Sections = tuple[tuple[float, float, float, float], ...]
TANK: Sections = (
    (0.44, 0.86, 0.09, 0.08), (0.38, 0.90, 0.15, 0.11), (0.22, 0.92, 0.18, 0.13),
    (0.05, 0.90, 0.17, 0.12), (-0.08, 0.85, 0.11, 0.08),
)  # fmt: skip
SEAT: Sections = (
    (-0.02, 0.83, 0.10, 0.04), (-0.16, 0.80, 0.15, 0.06), (-0.40, 0.81, 0.16, 0.06),
    (-0.52, 0.86, 0.14, 0.06), (-0.80, 0.89, 0.11, 0.05),
)  # fmt: skip
TAIL: Sections = ((-0.20, 0.70, 0.11, 0.07), (-0.50, 0.77, 0.13, 0.06), (-0.80, 0.83, 0.10, 0.05), (-0.94, 0.87, 0.06, 0.03))
SCOOTER_BODY: Sections = (
    (-0.08, 0.42, 0.13, 0.16), (-0.20, 0.52, 0.17, 0.20), (-0.50, 0.55, 0.19, 0.18),
    (-0.80, 0.62, 0.15, 0.12), (-0.95, 0.68, 0.08, 0.05),
)  # fmt: skip
SCOOTER_SEAT: Sections = (
    (-0.06, 0.76, 0.11, 0.04),
    (-0.20, 0.77, 0.15, 0.06),
    (-0.50, 0.78, 0.16, 0.06),
    (-0.82, 0.81, 0.12, 0.05),
)
CASE: Sections = (
    (-1.12, 1.02, 0.15, 0.09), (-1.10, 1.03, 0.19, 0.12), (-0.95, 1.04, 0.21, 0.14),
    (-0.80, 1.03, 0.20, 0.12), (-0.75, 1.02, 0.15, 0.08),
)  # fmt: skip
PANNIER: Sections = ((-0.92, 0.60, 0.05, 0.10), (-0.88, 0.60, 0.09, 0.17), (-0.50, 0.61, 0.09, 0.17), (-0.42, 0.63, 0.06, 0.11))
"""Rounded bodies: centre x, centre z, half width and half height of sections from one end to the other, m."""


def bicycle() -> Mesh:
    """A city bicycle with saddle, mudguards, rack, basket, lamps and pedals."""
    m, cls = MeshBuilder(), CLASS_ID["bicycle"]
    for x in (-0.52, 0.52):
        disc(m, (x, 0.0, 0.35), 0.35 / 0.94, Appearance(Material.SPOKES, cls), 1.0, 16)
        tube(m, (x, -0.026, 0.35), (x, 0.026, 0.35), (0.35, 0.35), Appearance(Material.PAINT, cls, 0, DARK), 16)
    bars: tuple[tuple[Point, Point], ...] = (
        ((-0.52, 0, 0.34), (0.0, 0, 0.32)), ((0.0, 0, 0.32), (0.38, 0, 0.80)), ((0.52, 0, 0.34), (0.36, 0, 1.02)),
        ((-0.17, 0, 0.92), (0.0, 0, 0.32)), ((-0.14, 0, 0.80), (0.40, 0, 0.84)), ((-0.52, 0, 0.34), (-0.14, 0, 0.78)),
        ((0.33, -0.26, 1.03), (0.33, 0.26, 1.03)), ((0.0, 0.0, 0.32), (0.12, 0.10, 0.20)), ((0.0, 0.0, 0.32), (-0.12, -0.10, 0.44)),
    )  # fmt: skip
    for a, b in bars:
        tube(m, a, b, (0.028, 0.028), Appearance(Material.PAINT, cls, 0, PAINTWORK), 5)
    box(m, (-0.34, -0.10, 0.91), (-0.06, 0.10, 0.97), Appearance(Material.CLOTH, cls, 0, DARK), bottom=True)
    box(m, (-0.78, -0.07, 0.74), (-0.24, 0.07, 0.76), Appearance(Material.METAL, cls, 0, STEEL), bottom=True)
    for x, way in ((-0.52, -1.0), (0.52, 1.0)):
        angle = np.linspace(0.15, 0.85, 5) * np.pi
        arc = np.column_stack([x - 0.37 * np.cos(angle) * way, np.zeros(5), 0.34 + 0.37 * np.sin(angle)])
        for a, b in pairwise(arc):
            tube(m, a, b, (0.03, 0.03), Appearance(Material.PAINT, cls, 0, PAINTWORK), 4)
    box(m, (0.42, -0.17, 0.86), (0.70, 0.17, 1.06), Appearance(Material.PICKETS, cls, 0, DARK), 0.5)
    box(m, (-0.80, -0.04, 0.62), (-0.76, 0.04, 0.70), Appearance(Material.LIT, cls, 0, TAIL_LAMP))
    box(m, (0.40, -0.04, 0.78), (0.46, 0.04, 0.86), Appearance(Material.PAINT, cls, 0, WHITE_LAMP))
    for y in (0.11, -0.11):  # panniers
        box(
            m,
            (-0.72, y - 0.05, 0.46),
            (-0.44, y + 0.05, 0.74),
            Appearance(Material.CLOTH, cls, 0, (0.16, 0.14, 0.12)),
            0.6,
            bottom=True,
        )
    box(m, (-0.50, -0.045, 0.25), (0.12, -0.035, 0.40), Appearance(Material.PAINT, cls, 0, DARK))  # chain case
    for y in (0.035, -0.035):  # skirt guards over the rear wheel
        rim = [(-0.52 - 0.33 * np.cos(a), y, 0.35 + 0.33 * np.sin(a)) for a in np.linspace(0.25, 0.75, 5) * np.pi]
        guard = [[(-0.52, y, 0.42), a, b, b] for a, b in pairwise(rim if y < 0 else rim[::-1])]
        m.quads(guard, np.zeros((len(guard), 4, 2)), Material.CLOTH, cls, 0, DARK)
    for y, x, z in ((0.13, 0.12, 0.18), (-0.13, -0.12, 0.42)):
        box(m, (x - 0.05, y - 0.05, z), (x + 0.05, y + 0.05, z + 0.03), Appearance(Material.PAINT, cls, 0, DARK), bottom=True)
    return m.build()


def motorcycle(touring: bool = False) -> Mesh:
    """A motorcycle with all that shows on one; a touring one has a screen, a fairing, panniers and a case behind its seat."""
    m, cls = MeshBuilder(), CLASS_ID["motorcycle"]
    _wheel(m, 0.74, 0.31, 0.055, cls)
    _wheel(m, -0.68, 0.31, 0.085, cls)
    _front_end(m, 0.74, 0.31, 0.50, cls)
    _engine(m, cls)
    _exhaust(m, cls)
    _lofted(m, TANK, Material.PAINT, PAINTWORK, cls)
    _lofted(m, SEAT, Material.CLOTH, DARK, cls)
    _lofted(m, TAIL, Material.PAINT, PAINTWORK, cls)
    _rear_end(m, -0.94, 0.80, cls)
    if touring:
        _touring(m, cls)
    return m.build()


def scooter() -> Mesh:
    """A motor scooter: leg shield, footboard, bodywork over the rear wheel, a rack."""
    m, cls = MeshBuilder(), CLASS_ID["motorcycle"]
    _wheel(m, 0.66, 0.235, 0.05, cls)
    _wheel(m, -0.62, 0.235, 0.06, cls)
    for way in (1.0, -1.0):
        tube(m, (0.66, 0.075 * way, 0.235), (0.50, 0.06 * way, 0.60), (0.026, 0.026), Appearance(Material.METAL, cls, 0, STEEL), 6)
    _arc(m, 0.66, 0.235, 0.27, 0.075, (0.10, 0.95), PAINTWORK, cls)
    shield = ((0.34, 0.24, 0.17), (0.50, 0.52, 0.20), (0.47, 0.80, 0.19), (0.42, 0.98, 0.11))
    for (xa, za, ya), (xb, zb, yb) in pairwise(shield):
        for push, way in ((0.0, -1.0), (0.10, 1.0)):
            bow = push * 0.6
            for side in (1.0, -1.0):
                corners = [(xa, side * ya, za), (xa + push + bow, 0.0, za), (xb + push + bow, 0.0, zb), (xb, side * yb, zb)]
                tint = PAINTWORK if way > 0 else DARK
                m.quads([corners], [[(0, 0), (0.1, 0), (0.1, 0.2), (0, 0.2)]], Material.PAINT, cls, 0, tint)
    box(m, (-0.22, -0.16, 0.22), (0.36, 0.16, 0.30), Appearance(Material.PAINT, cls, 0, DARK), bottom=True)
    _lofted(m, SCOOTER_BODY, Material.PAINT, PAINTWORK, cls)
    _lofted(m, SCOOTER_SEAT, Material.CLOTH, DARK, cls)
    tube(m, (-0.15, 0.13, 0.24), (-0.62, 0.14, 0.235), (0.09, 0.07), Appearance(Material.METAL, cls, 0, ALLOY), 8)
    tube(m, (-0.30, -0.15, 0.24), (-0.80, -0.17, 0.32), (0.06, 0.07), Appearance(Material.METAL, cls, 0, STEEL), 8)
    box(m, (0.30, -0.10, 0.98), (0.50, 0.10, 1.08), Appearance(Material.PAINT, cls, 0, PAINTWORK), bottom=True)
    box(m, (0.49, -0.08, 0.90), (0.55, 0.08, 1.02), Appearance(Material.PAINT, cls, 0, WHITE_LAMP))
    _bar(m, 0.36, 1.05, cls)
    tube(m, (-0.80, 0, 0.80), (-0.98, 0, 0.84), (0.05, 0.03), Appearance(Material.METAL, cls, 0, STEEL), 5)
    for way in (1.0, -1.0):
        lo, hi = sorted((way * 0.13, way * 0.19))
        box(m, (0.50, lo, 0.72), (0.58, hi, 0.77), Appearance(Material.PAINT, cls, 0, AMBER), bottom=True)
    _rear_end(m, -0.95, 0.66, cls)
    return m.build()


def _lofted(
    m: MeshBuilder, sections: Sections, material: Material, tint: tuple[float, ...], cls: int, beside_m: float = 0.0
) -> None:
    """A rounded body along x, beside_m to the left of the middle, closed at both ends."""
    angle = np.arange(13) * (2 * np.pi / 12)
    y, z = np.cos(angle), np.sin(angle)
    rings = [np.column_stack([np.full(13, x), beside_m + half * y, zc + tall * z]) for x, zc, half, tall in sections]
    shade = np.column_stack([np.zeros(13), y, z])
    ends = [np.broadcast_to(ring.mean(axis=0), ring.shape) for ring in (rings[0], rings[-1])]
    for a, b in pairwise([ends[0], *rings, ends[1]]):
        corners, normals = (np.stack([p[:-1], p[1:], q[1:], q[:-1]], axis=1) for p, q in ((a, b), (shade, shade)))
        m.quads(corners, corners[..., [0, 2]] / 2, material, cls, 0, tint, normals)


def _wheel(m: MeshBuilder, x: float, radius: float, half: float, cls: int) -> None:
    """A wheel that one sees through: round tyre, rim, cast spokes, brake discs, hub."""
    rim = 0.68 * radius
    tyre = ((rim, -0.6 * half), (0.86 * radius, -half), (0.97 * radius, -0.6 * half), (radius, 0.0),
            (0.97 * radius, 0.6 * half), (0.86 * radius, half), (rim, 0.6 * half))  # fmt: skip
    lathe(m, (x, 0.0, radius), tyre, Appearance(Material.PAINT, cls, tint=TYRE), WHEEL_SIDES)
    well = ((rim, 0.62 * half), (0.9 * rim, 0.5 * half), (0.9 * rim, -0.5 * half), (rim, -0.62 * half))
    lathe(m, (x, 0.0, radius), well, Appearance(Material.METAL, cls, tint=DARK), WHEEL_SIDES)
    for k in range(WHEEL_SPOKES):
        a = 2 * np.pi * (k + 0.25) / WHEEL_SPOKES
        out = np.array([np.cos(a), 0.0, np.sin(a)])
        at = np.array([x, 0.0, radius])
        tube(m, at + 0.04 * out, at + 0.92 * rim * out, (0.026, 0.018), Appearance(Material.PAINT, cls, 0, (0.06, 0.06, 0.065)), 5)
    for y in (0.55 * half, -0.55 * half):
        lathe(m, (x, 0.0, radius), ((0.40 * radius, y), (0.56 * radius, y)), Appearance(Material.METAL, cls, tint=ALLOY), 14)
    tube(m, (x, -half - 0.03, radius), (x, half + 0.03, radius), (0.045, 0.045), Appearance(Material.METAL, cls, 0, DARK), 8)


def _arc(
    m: MeshBuilder, x: float, z: float, radius: float, half: float, span: tuple[float, float], tint: tuple[float, ...], cls: int
) -> None:
    """A mudguard: part of a drum around a wheel, from and to so many half turns from ahead over the top, with low sides."""
    angle = np.linspace(*span, 7) * np.pi
    p = np.column_stack([x + radius * np.cos(angle), np.zeros(7), z + radius * np.sin(angle)])
    inner = np.column_stack([x + 0.86 * radius * np.cos(angle), np.zeros(7), z + 0.86 * radius * np.sin(angle)])
    profile = [(inner, -half), (p, -0.75 * half), (p, 0.75 * half), (inner, half)]
    for (a, ya), (b, yb) in pairwise(profile):
        lines = [line + np.array([0.0, y, 0.0]) for line, y in ((a, ya), (b, yb))]
        corners = np.stack([lines[0][:-1], lines[0][1:], lines[1][1:], lines[1][:-1]], axis=1)
        m.quads(corners, corners[..., [0, 2]] / 2, Material.PAINT, cls, 0, tint)


def _front_end(m: MeshBuilder, x: float, radius: float, head_x: float, cls: int) -> None:
    """Fork, mudguard, lamp, instruments and handlebar of a motorcycle."""
    for way in (1.0, -1.0):
        foot, joint, top = (x, way * 0.095, radius), (x - 0.11, way * 0.095, 0.62), (head_x - 0.03, way * 0.095, 0.99)
        tube(m, foot, joint, (0.032, 0.030), Appearance(Material.METAL, cls, 0, DARK), 7)
        tube(m, joint, top, (0.024, 0.024), Appearance(Material.METAL, cls, 0, CHROME), 7)
        box(
            m,
            (x - 0.05, way * 0.07 - 0.02, 0.40),
            (x + 0.03, way * 0.07 + 0.02, 0.50),
            Appearance(Material.METAL, cls, 0, BLACK),
            bottom=True,
        )
        lo, hi = sorted((way * 0.14, way * 0.19))
        box(m, (head_x + 0.03, lo, 0.84), (head_x + 0.07, hi, 0.87), Appearance(Material.PAINT, cls, 0, AMBER), bottom=True)
    _arc(m, x, radius, radius + 0.035, 0.075, (0.22, 0.82), PAINTWORK, cls)
    lamp = ((head_x - 0.04, 0.90, 0.07, 0.07), (head_x + 0.06, 0.90, 0.10, 0.10), (head_x + 0.15, 0.90, 0.105, 0.105))
    _lofted(m, lamp, Material.PAINT, BLACK, cls)
    _lofted(m, ((head_x + 0.15, 0.90, 0.09, 0.09), (head_x + 0.175, 0.90, 0.06, 0.06)), Material.PAINT, WHITE_LAMP, cls)
    box(m, (head_x - 0.06, -0.10, 1.02), (head_x + 0.04, 0.10, 1.11), Appearance(Material.PAINT, cls, 0, BLACK), bottom=True)
    _bar(m, head_x - 0.10, 1.05, cls)


def _bar(m: MeshBuilder, x: float, z: float, cls: int) -> None:
    """Handlebar with grips, levers, tanks of brake fluid and mirrors on their stalks."""
    for way in (1.0, -1.0):
        tube(
            m,
            (x + 0.04, way * 0.05, z - 0.03),
            (x, way * 0.24, z + 0.02),
            (0.015, 0.015),
            Appearance(Material.METAL, cls, 0, STEEL),
            5,
        )
        tube(m, (x, way * 0.22, z + 0.02), (x - 0.07, way * 0.39, z), (0.021, 0.021), Appearance(Material.PAINT, cls, 0, BLACK), 6)
        lever = (x + 0.05, way * 0.22, z + 0.02), (x + 0.02, way * 0.38, z - 0.01)
        tube(m, *lever, (0.008, 0.008), Appearance(Material.METAL, cls, 0, STEEL), 4)
        tube(
            m,
            (x + 0.01, way * 0.25, z + 0.02),
            (x + 0.05, way * 0.37, z + 0.17),
            (0.009, 0.009),
            Appearance(Material.METAL, cls, 0, BLACK),
            4,
        )
        _mirror(m, (x + 0.05, way * 0.40, z + 0.19), 0.075, 0.045, cls)


def _mirror(m: MeshBuilder, at: Point, half: float, tall: float, cls: int) -> None:
    """A mirror's shell, an ellipse of half width and height, m."""
    x, y, z = at
    for side in (-0.02, 0.02):
        angle = np.arange(9) * np.pi / 4
        rim = np.column_stack([np.full(9, x), y + half * np.cos(angle), z + tall * np.sin(angle)])
        middle = np.broadcast_to((x + side, y, z), (8, 3))
        corners = np.stack([middle, rim[:-1], rim[1:], rim[1:]], axis=1)
        material, tint = (Material.GLASS, (1.0, 1.0, 1.0)) if side < 0 else (Material.PAINT, BLACK)
        m.quads(corners, np.zeros((8, 4, 2)), material, cls, 0, tint)


def _engine(m: MeshBuilder, cls: int) -> None:
    """Crankcase with round covers, two finned cylinders, radiator, frame, swing arm, springs, rests, side stand."""
    tube(m, (0.06, -0.20, 0.38), (0.06, 0.20, 0.38), (0.15, 0.15), Appearance(Material.METAL, cls, 0, (0.18, 0.18, 0.19)), 12)
    box(m, (-0.20, -0.15, 0.26), (0.10, 0.15, 0.50), Appearance(Material.METAL, cls, 0, (0.12, 0.12, 0.13)), 0.4, bottom=True)
    for way in (1.0, -1.0):
        lathe(
            m,
            (0.08, 0.0, 0.38),
            ((0.0, way * 0.225), (0.09, way * 0.22), (0.12, way * 0.195)),
            Appearance(Material.METAL, cls, tint=ALLOY),
            12,
        )
        lathe(
            m,
            (-0.12, 0.0, 0.38),
            ((0.0, way * 0.185), (0.07, way * 0.18), (0.08, way * 0.14)),
            Appearance(Material.METAL, cls, tint=STEEL),
            10,
        )
        for a, b, thick in FRAME:
            from_, to = ((x, way * y, z) for x, y, z in (a, b))
            tube(m, from_, to, (thick, thick), Appearance(Material.PAINT, cls, 0, BLACK), 6)
        tube(m, (-0.56, way * 0.13, 0.36), (-0.38, way * 0.13, 0.72), (0.032, 0.032), Appearance(Material.METAL, cls, 0, CHROME), 7)
        tube(m, (-0.22, way * 0.15, 0.33), (-0.20, way * 0.28, 0.34), (0.018, 0.018), Appearance(Material.METAL, cls, 0, STEEL), 5)
        tube(m, (-0.42, way * 0.13, 0.42), (-0.44, way * 0.25, 0.44), (0.016, 0.016), Appearance(Material.METAL, cls, 0, STEEL), 5)
    for k in range(6):
        low = 0.50 + 0.042 * k
        near = 0.03 + 0.02 * k
        box(m, (near, -0.165, low), (near + 0.22, 0.165, low + 0.020), Appearance(Material.METAL, cls, 0, STEEL), bottom=True)
    box(m, (0.06, -0.13, 0.48), (0.27, 0.13, 0.76), Appearance(Material.METAL, cls, 0, BLACK), bottom=True)
    box(m, (0.37, -0.15, 0.44), (0.41, 0.15, 0.72), Appearance(Material.METAL, cls, 0, BLACK), bottom=True)
    box(m, (-0.34, -0.12, 0.52), (-0.10, 0.12, 0.76), Appearance(Material.PAINT, cls, 0, BLACK), bottom=True)
    tube(m, (-0.05, 0.16, 0.28), (0.06, 0.30, 0.0), (0.014, 0.014), Appearance(Material.METAL, cls, 0, STEEL), 5)


def _exhaust(m: MeshBuilder, cls: int) -> None:
    """Two pipes from the cylinders under the engine into one silencer beside the rear wheel."""
    for y in (-0.09, 0.09):
        way = ((0.28, y, 0.58), (0.40, y, 0.44), (0.36, y * 1.1, 0.27), (0.10, y, 0.20), (-0.22, -0.10, 0.24), (-0.36, -0.17, 0.30))
        for a, b in pairwise(way):
            tube(m, a, b, (0.024, 0.024), Appearance(Material.METAL, cls, 0, CHROME), 6)
    tube(m, (-0.34, -0.17, 0.29), (-0.46, -0.20, 0.34), (0.03, 0.062), Appearance(Material.METAL, cls, 0, CHROME), 9)
    tube(m, (-0.46, -0.20, 0.34), (-0.92, -0.24, 0.50), (0.062, 0.066), Appearance(Material.METAL, cls, 0, CHROME), 9)
    tube(m, (-0.92, -0.24, 0.50), (-0.95, -0.243, 0.51), (0.066, 0.02), Appearance(Material.METAL, cls, 0, BLACK), 9)


def _rear_end(m: MeshBuilder, x: float, z: float, cls: int) -> None:
    """Mudguard, plate, lamp and blinkers behind a tail that ends at x, z m."""
    tube(m, (x + 0.10, 0, z + 0.02), (x - 0.04, 0, z - 0.28), (0.07, 0.06), Appearance(Material.PAINT, cls, 0, BLACK), 6)
    box(m, (x - 0.115, -0.09, z - 0.28), (x - 0.10, 0.09, z - 0.13), Appearance(Material.PAINT, cls, 0, PLATE))
    box(m, (x - 0.03, -0.065, z - 0.01), (x + 0.02, 0.065, z + 0.045), Appearance(Material.LIT, cls, 0, TAIL_LAMP))
    for way in (1.0, -1.0):
        lo, hi = sorted((way * 0.12, way * 0.17))
        box(m, (x, lo, z - 0.055), (x + 0.03, hi, z - 0.03), Appearance(Material.PAINT, cls, 0, AMBER), bottom=True)
        tube(
            m,
            (x + 0.02, 0, z - 0.04),
            (x + 0.02, way * 0.13, z - 0.04),
            (0.007, 0.007),
            Appearance(Material.PAINT, cls, 0, BLACK),
            4,
        )


def _touring(m: MeshBuilder, cls: int) -> None:
    """Screen, fairing, panniers and a case."""
    for way in (1.0, -1.0):
        flank = [(0.66, way * 0.10, 0.84), (0.40, way * 0.21, 0.55), (0.22, way * 0.21, 0.70), (0.40, way * 0.19, 1.02)]
        nose = [(0.66, way * 0.10, 0.84), (0.40, way * 0.19, 1.02), (0.46, way * 0.10, 1.10), (0.62, 0.0, 1.0)]
        for corners in (flank, nose):
            m.quads([corners], [[(0, 0.2), (0.1, 0.2), (0.1, 0), (0, 0)]], Material.PAINT, cls, 0, PAINTWORK)
        screen = [(0.60, 0.0, 1.06), (0.50, way * 0.18, 1.06), (0.38, way * 0.15, 1.36), (0.44, 0.0, 1.40)]
        m.quads([screen], [[(0, 1), (1, 1), (1, 0), (0, 0)]], Material.GLASS, cls)
        _lofted(m, PANNIER, Material.PAINT, BLACK, cls, way * 0.29)
        tube(m, (-0.62, way * 0.12, 0.72), (-0.62, way * 0.26, 0.66), (0.015, 0.015), Appearance(Material.METAL, cls, 0, STEEL), 5)
    _lofted(m, CASE, Material.PAINT, BLACK, cls)
    tube(m, (-0.94, -0.1, 0.88), (-0.94, 0.1, 0.94), (0.03, 0.03), Appearance(Material.METAL, cls, 0, STEEL), 5)
