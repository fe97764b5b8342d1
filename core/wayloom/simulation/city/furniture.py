"""Street furniture: lamps, signs, traffic lights, bollards, bins, shelters, fences and garden walls."""

from collections.abc import Sequence

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.streets import F64
from wayloom.simulation.models.mesh import MeshBuilder
from wayloom.simulation.models.solids import Appearance, box, post, tube
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.textures.paint_objects import SIGN_COLUMNS, SIGN_ROWS

POLE, SIGN, LIGHT = CLASS_ID["pole"], CLASS_ID["traffic sign"], CLASS_ID["traffic light"]
FENCE, WALL, BUILDING = CLASS_ID["fence"], CLASS_ID["wall"], CLASS_ID["building"]
SIGN_KINDS = SIGN_COLUMNS * SIGN_ROWS
GREY = (0.7, 0.7, 0.7)
BACK_OF_SIGN = (0.3, 0.3, 0.3)
LAMP_TOP_M, SIGN_POST_TOP_M, SIGN_M, BOLLARD_TOP_M = 6.64, 2.75, (2.08, 2.74), 0.97
FENCE_LIGHTEST = {Material.RAILS: 5.0, Material.PICKETS: 2.4, Material.MESH: 2.5}
"""Factor on the material's colour: galvanised rails, pickets painted white."""
PIER_EVERY_M, PIER_M = 3.0, 0.42
SIGNAL_M, SIGNAL_HALF_M, LENS_M = 1.15, 0.14, 0.137
VISOR_M, VISOR_RADIUS_M = 0.26, 0.155
"""Height of a signal's head, from its middle to its face, radius of a lamp."""
LAMP_TINTS = ((1.0, 0.05, 0.02), (1.0, 0.45, 0.02), (0.05, 0.95, 0.35))
UNLIT_TINTS = ((0.12, 0.015, 0.012), (0.16, 0.10, 0.02), (0.01, 0.10, 0.05))
LENS_UV = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
BOARD = ((-0.18, 0.31, 0.11, (0.1, 0.1, 0.1)), (-0.17, 0.31, 0.11, (2.6, 2.6, 2.6)), (-0.165, 0.27, 0.07, (0.1, 0.1, 0.1)))
"""Layers behind a signal over the road, back to front: place m, half width, how far they stand out above and below, tint."""


def lamp_post(m: MeshBuilder, at: F64, to_street: F64, number: int) -> None:
    """A street lamp with an arm of 1.6 m over the road."""
    post(m, at[0], at[1], (0, 0.9), (0.09, 0.09), Appearance(Material.METAL, POLE, number))
    post(m, at[0], at[1], (0.9, 6.4), (0.06, 0.045), Appearance(Material.METAL, POLE, number))
    end = at + to_street * 1.6
    tube(m, (*at, 6.35), (*end, 6.6), (0.04, 0.03), Appearance(Material.METAL, POLE, number), sides=5)
    yaw = float(np.arctan2(to_street[1], to_street[0]))
    box(
        m,
        (-0.35, -0.12, 6.52),
        (0.35, 0.12, 6.64),
        Appearance(Material.METAL, POLE, number, GREY),
        1,
        (end[0], end[1]),
        yaw,
        bottom=True,
    )


def _plate(m: MeshBuilder, at: F64, facing: F64, z: tuple[float, float], half_m: float, kind: int, number: int) -> None:
    """Sign `kind` on a thin plate that faces `facing`, and its grey back of the same shape."""
    to_its_right = np.array([-facing[1], facing[0]]) * half_m  # as who looks at it sees it
    u0, v0 = (kind % SIGN_COLUMNS) / SIGN_COLUMNS, (kind // SIGN_COLUMNS) / SIGN_ROWS
    u1, v1 = u0 + 1 / SIGN_COLUMNS, v0 + 1 / SIGN_ROWS
    for off, tint in ((0.05, (1.0, 1.0, 1.0)), (0.035, BACK_OF_SIGN)):
        a, b = at + facing * off - to_its_right, at + facing * off + to_its_right
        quad = [(*a, z[0]), (*b, z[0]), (*b, z[1]), (*a, z[1])]
        m.quads([quad], [[(u0, v1), (u1, v1), (u1, v0), (u0, v0)]], Material.SIGNS, SIGN, number, tint)


def sign_post(m: MeshBuilder, at: F64, facing: F64, kind: int, post_number: int, sign_number: int) -> None:
    """A sign, 0.66 m wide, on a post."""
    post(m, at[0], at[1], (0, SIGN_POST_TOP_M), (0.032, 0.032), Appearance(Material.METAL, POLE, post_number, (1.2, 1.2, 1.2)), 6)
    _plate(m, at, facing, SIGN_M, 0.33, kind, sign_number)


def signal_post_m(arm_m: float) -> float:
    """Height of a traffic light's post."""
    return 3.5 if arm_m == 0 else 5.9


def traffic_light(
    m: MeshBuilder, at: F64, facing: F64, to_street: F64, arm_m: float, post_number: int, numbers: Sequence[int]
) -> list[tuple[F64, int]]:
    """Signal heads on a post and, where arm_m > 0, one more over the road; each with an instance number from `numbers`.

    Returns the foot (3,) of each head's face, and its number; what is lit is added when the time is known.
    """
    tall = signal_post_m(arm_m)
    post(m, at[0], at[1], (0, tall), (0.08, 0.07), Appearance(Material.METAL, POLE, post_number))
    heads = [(at + facing * 0.22, 2.45, False)]
    if arm_m > 0:
        end = at + to_street * arm_m
        tube(m, (*at, tall - 0.1), (*end, tall + 0.15), (0.06, 0.04), Appearance(Material.METAL, POLE, post_number), sides=6)
        heads.append((end + facing * 0.16, tall - 0.75, True))
    return [
        (_signal_head(m, place, facing, foot, number, board), number)
        for (place, foot, board), number in zip(heads, numbers, strict=True)
    ]


def _signal_head(m: MeshBuilder, at: F64, facing: F64, foot_m: float, number: int, board: bool) -> F64:
    """A box of three dark lamps under visors, optionally before a black board with a white rim; returns its face's foot (3,)."""
    yaw = float(np.arctan2(facing[1], facing[0]))
    place, dark = (float(at[0]), float(at[1])), (0.12, 0.13, 0.12)
    low, high = foot_m, foot_m + SIGNAL_M
    for x, half, over, tint in BOARD if board else ():
        lo, hi = (x, -half, low - over), (x + 0.01, half, high + over)
        box(m, lo, hi, Appearance(Material.METAL, LIGHT, number, tint), 1, place, yaw, bottom=True)
    lo, hi = (-0.155, -0.20, low), (SIGNAL_HALF_M, 0.20, high)
    box(m, lo, hi, Appearance(Material.METAL, LIGHT, number, dark), 1, place, yaw, bottom=True)
    face = np.array([*(at + facing * SIGNAL_HALF_M), foot_m])
    for k, unlit in enumerate(UNLIT_TINTS):
        m.quads(lens(face, facing, k, 0.006), [LENS_UV] * 3, Material.PAINT, LIGHT, number, unlit)
        _visor(m, face + np.array([0.0, 0.0, (2.5 - k) * SIGNAL_M / 3]), facing, number, dark)
    return face


def _visor(m: MeshBuilder, middle: F64, facing: F64, number: int, tint: tuple[float, float, float]) -> None:
    """A tube, open below, over the lamp whose middle (3,) it stands out from."""
    angle = np.linspace(-0.6, np.pi + 0.6, 8)
    ring = VISOR_RADIUS_M * (np.cos(angle)[:, None] * [facing[1], -facing[0], 0.0] + np.sin(angle)[:, None] * (0.0, 0.0, 1.0))
    out = VISOR_M * (0.6 + 0.4 * np.sin(angle.clip(0, np.pi)))[:, None] * [*facing, 0.0]
    inner, outer = middle + ring, middle + ring + out
    corners = np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1)
    m.quads(corners, np.zeros((len(corners), 4, 2)), Material.METAL, LIGHT, number, tint)


def lens(face: F64, facing: F64, which: int, out_m: float) -> F64:
    """(3, 4, 3) the eight-cornered lens of a signal's lamp (0 red, 1 amber, 2 green), out_m m before its face."""
    angle = np.pi / 8 + np.arange(9) * np.pi / 4
    to_its_left = np.array([facing[1], -facing[0]])  # as who looks at it sees it
    middle = face + np.array([*(facing * out_m), (2.5 - which) * SIGNAL_M / 3])
    rim = middle - LENS_M * (np.cos(angle)[:, None] * [*to_its_left, 0.0]) + LENS_M * np.sin(angle)[:, None] * (0.0, 0.0, 1.0)
    return np.stack([rim[[0, 1, 2, 3]], rim[[3, 4, 7, 0]], rim[[4, 5, 6, 7]]])


def bollard(m: MeshBuilder, at: F64, number: int) -> None:
    """A post of 0.95 m with a white band."""
    post(m, at[0], at[1], (0, 0.75), (0.055, 0.055), Appearance(Material.METAL, POLE, number, (0.45, 0.45, 0.45)))
    post(m, at[0], at[1], (0.75, 0.86), (0.057, 0.057), Appearance(Material.PAINT, POLE, number, (0.8, 0.8, 0.8)))
    post(m, at[0], at[1], (0.86, BOLLARD_TOP_M), (0.055, 0.04), Appearance(Material.METAL, POLE, number, (0.45, 0.45, 0.45)))


def cabinet(m: MeshBuilder, at: F64, yaw: float, number: int, rng: np.random.Generator) -> None:
    """A grey switch cabinet, a yellow letter box or a green bin."""
    tint = ((0.55, 0.58, 0.55), (0.75, 0.5, 0.03), (0.06, 0.2, 0.1))[rng.integers(3)]
    box(
        m,
        (-0.45, -0.22, KERB_M),
        (0.45, 0.22, rng.uniform(0.9, 1.4)),
        Appearance(Material.PAINT, BUILDING, number, tint),
        1,
        (at[0], at[1]),
        yaw,
    )


def shelter(m: MeshBuilder, at: F64, along: F64, to_street: F64, number: int) -> None:
    """A glass bus shelter, 4 m long."""
    yaw = float(np.arctan2(along[1], along[0]))
    place = (float(at[0]), float(at[1]))
    side = -1.0 if along[0] * to_street[1] - along[1] * to_street[0] < 0 else 1.0
    low, high = sorted((0.0, side * 1.4))
    box(m, (-2, low, 2.4), (2, high, 2.52), Appearance(Material.METAL, BUILDING, number), at=place, yaw=yaw, bottom=True)
    box(m, (-1.9, -0.03, 0.4), (1.9, 0.03, 2.3), Appearance(Material.GLASS, BUILDING, number, (3.0, 3.2, 3.2)), at=place, yaw=yaw)
    for x in (-1.95, 0.0, 1.95):
        box(m, (x - 0.04, -0.04, KERB_M), (x + 0.04, 0.04, 2.4), Appearance(Material.METAL, BUILDING, number), at=place, yaw=yaw)


def fence(m: MeshBuilder, a: F64, b: F64, number: int, rng: np.random.Generator) -> None:
    """Iron rails, wooden pickets or wire mesh from a to b (2,) m, with posts."""
    material = (Material.RAILS, Material.PICKETS, Material.MESH)[rng.integers(3)]
    high, length = rng.uniform(1.1, 1.7), float(np.hypot(*(b - a)))
    quad = [(*a, KERB_M - 0.05), (*b, KERB_M - 0.05), (*b, high), (*a, high)]
    repeat = max(1, round(length / 2))
    light = rng.uniform(0.9, FENCE_LIGHTEST[material])
    m.quads([quad], [[(0, 1), (repeat, 1), (repeat, 0), (0, 0)]], material, FENCE, number, (light, light, 0.97 * light))
    yaw = float(np.arctan2(*(b - a)[::-1]))
    for s in np.linspace(0, 1, repeat + 1):
        p = a + (b - a) * s
        box(
            m,
            (-0.04, -0.04, -0.1),
            (0.04, 0.04, high + 0.05),
            Appearance(Material.METAL, FENCE, number, (0.4, 0.42, 0.4)),
            at=(p[0], p[1]),
            yaw=yaw,
        )


def guard_rail(m: MeshBuilder, a: F64, b: F64, number: int) -> None:
    """Pedestrian railing along a kerb."""
    quad = [(*a, KERB_M), (*b, KERB_M), (*b, 1.1), (*a, 1.1)]
    repeat = max(1, round(float(np.hypot(*(b - a))) / 2))
    m.quads([quad], [[(0, 1), (repeat, 1), (repeat, 0), (0, 0)]], Material.RAILS, FENCE, number, (5.0, 5.0, 5.0))


def garden_wall(m: MeshBuilder, a: F64, b: F64, number: int, rng: np.random.Generator) -> None:
    """Brick, rubble or concrete with a coping and piers, from a to b (2,) m."""
    material = (Material.BRICK, Material.RUBBLE, Material.CONCRETE)[rng.integers(3)]
    high, length, yaw = rng.uniform(0.9, 2.2), float(np.hypot(*(b - a))), float(np.arctan2(*(b - a)[::-1]))
    box(m, (0, 0, -0.4), (length, 0.25, high), Appearance(material, WALL, number), metres=3.0, at=(a[0], a[1]), yaw=yaw)
    box(
        m,
        (0, -0.05, high),
        (length, 0.30, high + 0.09),
        Appearance(Material.CONCRETE, WALL, number),
        metres=3.0,
        at=(a[0], a[1]),
        yaw=yaw,
    )
    for x in np.linspace(0, length - PIER_M, max(2, round(length / PIER_EVERY_M) + 1)):
        lo, hi = (x, -0.09, -0.4), (x + PIER_M, 0.34, high + 0.14)
        box(m, lo, hi, Appearance(material, WALL, number), metres=3.0, at=(a[0], a[1]), yaw=yaw)
        lo, hi = (x - 0.05, -0.14, high + 0.14), (x + PIER_M + 0.05, 0.39, high + 0.22)
        box(m, lo, hi, Appearance(Material.CONCRETE, WALL, number, (1.2, 1.2, 1.2)), 3.0, (a[0], a[1]), yaw, bottom=True)
