"""Vehicles, modelled around their own origin: x forward, y left, wheels on z = 0. PAINTWORK marks what is recoloured."""

from collections.abc import Sequence

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.materials import Material
from wayloom.simulation.mesh import Mesh, MeshBuilder
from wayloom.simulation.solids import box, disc, tube

PAINTWORK = (0.5, 0.25, 0.125)
"""Tint by which paintwork is found (`mesh.recoloured`)."""
CAR_COLOURS = (
    (0.55, 0.56, 0.58), (0.03, 0.03, 0.035), (0.78, 0.78, 0.76), (0.03, 0.06, 0.2), (0.32, 0.03, 0.03), (0.14, 0.15, 0.17),
    (0.12, 0.2, 0.14), (0.30, 0.29, 0.27), (0.05, 0.13, 0.28), (0.02, 0.02, 0.02),
)  # fmt: skip
RED_LAMP, WHITE_LAMP, PLATE, RUBBER = (0.5, 0.03, 0.02), (0.9, 0.9, 0.85), (0.75, 0.75, 0.72), (0.04, 0.04, 0.04)
WHEEL_RADIUS_M = 0.32

Profile = Sequence[tuple[float, float]]
HATCHBACK: Profile = (
    (-1.95, 0.35),
    (-2.0, 0.62),
    (-1.92, 0.98),
    (-1.55, 1.42),
    (-0.2, 1.50),
    (0.35, 1.42),
    (1.10, 1.02),
    (1.75, 0.86),
    (1.98, 0.66),
    (2.0, 0.35),
)
SALOON: Profile = (
    (-2.25, 0.35),
    (-2.3, 0.72),
    (-2.18, 0.98),
    (-1.55, 1.04),
    (-0.95, 1.40),
    (0.05, 1.44),
    (0.45, 1.36),
    (1.15, 1.0),
    (1.95, 0.86),
    (2.22, 0.66),
    (2.25, 0.35),
)
ESTATE: Profile = (
    (-2.25, 0.35),
    (-2.3, 0.70),
    (-2.22, 1.0),
    (-1.95, 1.38),
    (-0.5, 1.48),
    (0.4, 1.40),
    (1.15, 1.02),
    (1.9, 0.88),
    (2.2, 0.66),
    (2.25, 0.35),
)
VAN: Profile = (
    (-2.4, 0.4),
    (-2.45, 0.9),
    (-2.42, 1.15),
    (-2.3, 1.88),
    (-0.6, 1.96),
    (0.8, 1.90),
    (1.65, 1.18),
    (2.2, 1.0),
    (2.42, 0.75),
    (2.42, 0.4),
)
CAR_PROFILES = (HATCHBACK, SALOON, ESTATE, VAN)


def _half_width(z: np.ndarray, belt: float, roof: float) -> np.ndarray:
    """Half width of a car body at height z m: widest at the belt, leaning in towards roof and sill."""
    lean = 0.20 * np.clip((z - belt) / (roof - belt), 0, 1) ** 1.2
    return np.asarray(0.87 - lean - 0.06 * np.clip((0.55 - z) / 0.3, 0, 1))


def _outline_normals(p: np.ndarray) -> np.ndarray:
    """(N, 2) outward normals at the points of a profile, averaged over both neighbours."""
    d = np.diff(p, axis=0)
    n = np.column_stack([-d[:, 1], d[:, 0]]) / np.linalg.norm(d, axis=1, keepdims=True)
    mean = np.vstack([n[:1], n[:-1] + n[1:], n[-1:]])
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))


def _is_window(p: np.ndarray, belt: float) -> np.ndarray:
    """(N - 1,) which strips of a profile are glass: those that climb from the belt to the roof."""
    low, high = np.minimum(p[:-1, 1], p[1:, 1]), np.maximum(p[:-1, 1], p[1:, 1])
    return np.asarray((high - low > 0.26) & (low > belt - 0.06))


def car(profile: Profile) -> Mesh:
    """A car: its profile drawn across the width, sides with windows, pillars, wheels, lamps and plates."""
    m, cls = MeshBuilder(), CLASS_ID["car"]
    p = np.array(profile)
    roof = float(p[:, 1].max())
    belt = 0.98 if roof < 1.7 else 1.15
    half, normal, glass = _half_width(p[:, 1], belt, roof), _outline_normals(p), _is_window(p, belt)
    for k in range(len(p) - 1):
        (x0, z0), (x1, z1), h0, h1 = p[k], p[k + 1], half[k], half[k + 1]
        corners = [(x0, h0, z0), (x0, -h0, z0), (x1, -h1, z1), (x1, h1, z1)]
        shade = [(normal[j][0], 0.0, normal[j][1]) for j in (k, k, k + 1, k + 1)]
        material, tint = (Material.GLASS, (1, 1, 1)) if glass[k] else (Material.PAINT, PAINTWORK)
        m.quads([corners], [[(x0 / 2, 0), (x0 / 2, 0.8), (x1 / 2, 0.8), (x1 / 2, 0)]], material, cls, 0, tint, [shade])
    for side in (1.0, -1.0):
        _car_side(m, p, side, belt, roof)
    front, back = float(p[:, 0].max()), float(p[:, 0].min())
    for x, lamp in ((front - 0.02, WHITE_LAMP), (back + 0.02, RED_LAMP)):
        for y in (0.6, -0.6):
            box(m, (x - 0.05, y - 0.19, 0.62), (x + 0.05, y + 0.19, 0.78), Material.PAINT, cls, 0, lamp)
        box(m, (x - 0.04, -0.26, 0.44), (x + 0.045, 0.26, 0.55), Material.PAINT, cls, 0, PLATE)
        box(m, (x - 0.03, -0.72, 0.30), (x + 0.035, 0.72, 0.42), Material.PAINT, cls, 0, RUBBER)
    box(m, (back + 0.1, -0.75, 0.2), (front - 0.1, 0.75, 0.32), Material.PAINT, cls, 0, RUBBER, bottom=True)
    return m.build()


def _car_side(m: MeshBuilder, p: np.ndarray, side: float, belt: float, roof: float) -> None:
    """One flank: lower body, windows with pillars, mirror, wheels in dark arches."""
    cls = CLASS_ID["car"]
    front, back = p[:, 0].max(), p[:, 0].min()
    outline = p[1:-1]
    x = np.linspace(back + 0.02, front - 0.02, 12)
    top = np.minimum(np.interp(x, outline[:, 0], outline[:, 1]), belt + 0.03)
    width = _half_width(top, belt, roof)
    for j in range(len(x) - 1):
        corners = [
            (x[j], side * 0.82, 0.26),
            (x[j + 1], side * 0.82, 0.26),
            (x[j + 1], side * width[j + 1], top[j + 1]),
            (x[j], side * width[j], top[j]),
        ]
        uv = [(x[j], 1), (x[j + 1], 1), (x[j + 1], 0), (x[j], 0)]
        shade = [(0, side * 0.98, -0.2), (0, side * 0.98, -0.2), (0, side * 0.93, 0.37), (0, side * 0.93, 0.37)]
        m.quads([corners], [uv], Material.PAINT, cls, 0, PAINTWORK, [shade])
    upper = outline[outline[:, 1] > belt - 0.02]
    xs = np.linspace(upper[0, 0], upper[-1, 0], 15)
    line = np.interp(xs, upper[:, 0], upper[:, 1])
    pillars = {0, 4, 8, 13} if roof < 1.7 else {0, 1, 2, 3, 4, 5, 9, 13}
    for j in range(len(xs) - 1):
        z_top = line[j : j + 2] - 0.05
        corners = [(xs[j], side * 0.87, belt), (xs[j + 1], side * 0.87, belt)]
        h = _half_width(z_top, belt, roof)
        corners += [(xs[j + 1], side * h[1], max(z_top[1], belt)), (xs[j], side * h[0], max(z_top[0], belt))]
        material, tint = (Material.PAINT, PAINTWORK) if j in pillars else (Material.GLASS, (1, 1, 1))
        m.quads([corners], [[(0, 1), (0.2, 1), (0.2, 0), (0, 0)]], material, cls, 0, tint, [[(0, side * 0.92, 0.4)] * 4])
        rim = [(xs[j], side * h[0], max(z_top[0], belt)), (xs[j + 1], side * h[1], max(z_top[1], belt))]
        h2 = _half_width(line[j : j + 2], belt, roof)
        rim += [(xs[j + 1], side * h2[1], line[j + 1]), (xs[j], side * h2[0], line[j])]
        m.quads([rim], [[(0, 1), (0.2, 1), (0.2, 0), (0, 0)]], Material.PAINT, cls, 0, PAINTWORK, [[(0, side * 0.8, 0.6)] * 4])
    box(m, (0.75, side * 0.98 - 0.1, belt), (0.92, side * 0.98 + 0.1, belt + 0.14), Material.PAINT, cls, 0, PAINTWORK, bottom=True)
    for wheel_x in (back + 0.8, front - 0.82):
        disc(m, (wheel_x, side * 0.845, 0.35), 0.40, Material.PAINT, cls, side, tint=(0.01, 0.01, 0.01))
        _wheel(m, wheel_x, side * 0.86, WHEEL_RADIUS_M, cls)


def _wheel(m: MeshBuilder, x: float, y: float, radius: float, class_id: int) -> None:
    """A wheel 0.2 m broad whose outer face lies at y."""
    side = 1.0 if y > 0 else -1.0
    disc(m, (x, y, radius), radius, Material.WHEEL, class_id, side)
    tube(m, (x, y - 0.2 * side, radius), (x, y, radius), (radius, radius), Material.PAINT, class_id, 0, (0.03, 0.03, 0.03), 14)


def lorry() -> Mesh:
    """A two-axle box lorry, 7.2 m."""
    m, cls = MeshBuilder(), CLASS_ID["truck"]
    box(m, (-3.6, -1.2, 0.95), (1.6, 1.2, 3.4), Material.PAINT, cls, 0, (0.72, 0.72, 0.70), 3, bottom=True)
    box(m, (-3.5, -0.9, 0.5), (3.2, 0.9, 0.95), Material.METAL, cls, 0, (0.4, 0.4, 0.4), 2, bottom=True)
    box(m, (1.75, -1.12, 0.5), (3.6, 1.12, 2.5), Material.PAINT, cls, 0, PAINTWORK, 3, bottom=True)
    box(m, (3.1, -1.06, 1.5), (3.62, 1.06, 2.35), Material.GLASS, cls)
    box(m, (2.3, -1.13, 1.5), (2.95, 1.13, 2.3), Material.GLASS, cls)
    for y in (0.85, -0.85):
        box(m, (3.55, y - 0.17, 0.75), (3.64, y + 0.17, 0.95), Material.PAINT, cls, 0, WHITE_LAMP)
        box(m, (-3.64, y - 0.17, 0.8), (-3.55, y + 0.17, 0.95), Material.PAINT, cls, 0, RED_LAMP)
    box(m, (-3.63, -0.3, 0.6), (-3.58, 0.3, 0.72), Material.PAINT, cls, 0, PLATE)
    box(m, (3.58, -0.9, 0.45), (3.66, 0.9, 0.68), Material.PAINT, cls, 0, RUBBER)
    for x in (-2.3, 2.6):
        for y in (1.17, -1.17):
            _wheel(m, x, y, 0.47, cls)
    return m.build()


def bus(length: float = 11.5, class_name: str = "bus") -> Mesh:
    """A city bus, or, with class "train", one section of a tram."""
    m, cls = MeshBuilder(), CLASS_ID[class_name]
    half, x0, x1, low, high = 1.25, -length / 2, length / 2, 0.3, 3.05 if class_name == "bus" else 3.4
    repeat = length / 6
    for y, way in ((half, -1.0), (-half, 1.0)):
        a, b = (x0, x1) if way > 0 else (x1, x0)
        m.quads(
            [[(a, y, low), (b, y, low), (b, y, high), (a, y, high)]],
            [[(0, 1), (repeat, 1), (repeat, 0), (0, 0)]],
            Material.BUS_SIDE,
            cls,
            0,
            PAINTWORK,
        )
    box(m, (x0, -half + 0.01, low), (x1, half - 0.01, high), Material.PAINT, cls, 0, PAINTWORK, 3, bottom=True)
    for x, lamp in ((x1, WHITE_LAMP), (x0, WHITE_LAMP if class_name == "train" else RED_LAMP)):
        box(m, (x - 0.04, -half + 0.1, 1.25), (x + 0.03, half - 0.1, 2.6), Material.GLASS, cls)
        box(m, (x - 0.04, -0.8, 2.65), (x + 0.03, 0.8, 2.95), Material.PAINT, cls, 0, (0.75, 0.45, 0.05))
        for y in (0.9, -0.9):
            box(m, (x - 0.04, y - 0.2, 0.6), (x + 0.04, y + 0.2, 0.82), Material.PAINT, cls, 0, lamp)
    if class_name == "bus":
        for x in (x0 + 2.6, x1 - 2.6):
            for y in (half + 0.005, -half - 0.005):
                _wheel(m, x, y, 0.48, cls)
    else:
        box(m, (x0 + 1, -1.0, 0.08), (x1 - 1, 1.0, 0.3), Material.PAINT, cls, 0, RUBBER)
        box(m, (-1.5, -0.8, high), (1.5, 0.8, high + 0.3), Material.METAL, cls)
    return m.build()


def two_wheeler(
    frame: np.ndarray, wheel_x: tuple[float, float], radius: float, class_id: int, tint: tuple[float, ...], thick: float
) -> Mesh:
    """Two wheels and the bars of a frame (N, 2, 3) m."""
    m = MeshBuilder()
    for x in wheel_x:
        if thick > 0.03:  # a motorcycle's wheel is solid
            for side in (1.0, -1.0):
                disc(m, (x, side * 0.06, radius), radius, Material.WHEEL, class_id, side)
            tube(m, (x, -0.06, radius), (x, 0.06, radius), (radius, radius), Material.PAINT, class_id, 0, (0.03, 0.03, 0.03), 14)
        else:
            disc(m, (x, 0.0, radius), radius / 0.94, Material.SPOKES, class_id, 1.0, 16)
    for a, b in frame:
        tube(m, a, b, (thick, thick), Material.PAINT, class_id, 0, tint, 5)
    return m.build()


def bicycle() -> Mesh:
    """A city bicycle."""
    bars = np.array(
        [
            [(-0.52, 0, 0.34), (0.0, 0, 0.32)], [(0.0, 0, 0.32), (0.38, 0, 0.80)], [(0.52, 0, 0.34), (0.36, 0, 1.02)],
            [(-0.17, 0, 0.92), (0.0, 0, 0.32)], [(-0.14, 0, 0.80), (0.40, 0, 0.84)], [(-0.52, 0, 0.34), (-0.14, 0, 0.78)],
            [(0.33, -0.26, 1.03), (0.33, 0.26, 1.03)], [(-0.32, 0, 0.93), (-0.06, 0, 0.94)], [(-0.62, 0, 0.74), (-0.2, 0, 0.74)],
        ]
    )  # fmt: skip
    return two_wheeler(bars, (-0.52, 0.52), 0.34, CLASS_ID["bicycle"], PAINTWORK, 0.022)


def motorcycle() -> Mesh:
    """A motorcycle or scooter with tank, seat and engine."""
    cls = CLASS_ID["motorcycle"]
    bars = np.array(
        [
            [(0.72, 0.08, 0.32), (0.45, 0.08, 1.0)],
            [(0.72, -0.08, 0.32), (0.45, -0.08, 1.0)],
            [(0.42, -0.36, 1.05), (0.42, 0.36, 1.05)],
            [(-0.68, 0.1, 0.32), (0.0, 0.1, 0.45)],
        ]
    )
    m = MeshBuilder()
    m.add(two_wheeler(bars, (-0.68, 0.72), 0.31, cls, (0.1, 0.1, 0.1), 0.035))
    box(m, (-0.25, -0.17, 0.28), (0.32, 0.17, 0.68), Material.METAL, cls, 0, (0.5, 0.5, 0.5), bottom=True)
    box(m, (-0.02, -0.16, 0.68), (0.40, 0.16, 0.95), Material.PAINT, cls, 0, PAINTWORK, bottom=True)
    box(m, (-0.85, -0.15, 0.70), (-0.02, 0.15, 0.84), Material.CLOTH, cls, 0, (0.04, 0.04, 0.04), bottom=True)
    box(m, (-0.98, -0.12, 0.62), (-0.70, 0.12, 0.74), Material.PAINT, cls, 0, PAINTWORK, bottom=True)
    box(m, (0.48, -0.14, 0.78), (0.62, 0.14, 1.02), Material.PAINT, cls, 0, WHITE_LAMP, bottom=True)
    box(m, (-1.0, -0.1, 0.55), (-0.96, 0.1, 0.70), Material.PAINT, cls, 0, RED_LAMP)
    return m.build()
