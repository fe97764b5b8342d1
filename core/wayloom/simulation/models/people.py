"""Pedestrian and rider models around their own origin: x forward, y left, feet on z = 0."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.models.mesh import Mesh, MeshBuilder
from wayloom.simulation.models.solids import Appearance, box, tube
from wayloom.simulation.textures.materials import Material

SKIN = ((0.75, 0.50, 0.38), (0.62, 0.40, 0.28), (0.30, 0.17, 0.11))
HAIR = ((0.05, 0.03, 0.02), (0.18, 0.10, 0.05), (0.35, 0.26, 0.14), (0.4, 0.4, 0.4))
COATS = (
    (0.03, 0.03, 0.04), (0.06, 0.08, 0.16), (0.30, 0.05, 0.05), (0.60, 0.58, 0.54), (0.22, 0.23, 0.24), (0.10, 0.16, 0.10),
    (0.45, 0.33, 0.20), (0.10, 0.22, 0.42), (0.65, 0.45, 0.08), (0.30, 0.16, 0.28), (0.80, 0.78, 0.74),
)  # fmt: skip
TROUSERS = ((0.04, 0.06, 0.13), (0.07, 0.10, 0.20), (0.02, 0.02, 0.025), (0.28, 0.23, 0.16), (0.14, 0.14, 0.15), (0.10, 0.08, 0.06))
SHOE = (0.05, 0.04, 0.03)
HELMETS = ((0.02, 0.02, 0.022), (0.02, 0.02, 0.022), (0.70, 0.70, 0.68), (0.35, 0.36, 0.37), (0.45, 0.03, 0.02), (0.03, 0.07, 0.28))
LEATHERS = (
    (0.02, 0.02, 0.022),
    (0.03, 0.03, 0.035),
    (0.06, 0.06, 0.065),
    (0.02, 0.03, 0.07),
    (0.10, 0.05, 0.03),
    (0.22, 0.03, 0.03),
)
STEP_PHASES = 8
"""How many poses a step is cut into."""
Point = tuple[float, float, float]
Tint = tuple[float, ...] | np.ndarray


@dataclass(frozen=True, slots=True)
class Look:
    """Linear colours of coat, trousers, hair and skin; whether there is a skirt, a rucksack, a bag, long hair."""

    coat: np.ndarray
    trousers: np.ndarray
    hair: Tint
    skin: Tint
    skirt: bool
    rucksack: bool
    bag: bool
    long_hair: bool


def _clothes(rng: np.random.Generator, colours: tuple[tuple[float, float, float], ...]) -> np.ndarray:
    """(3,) one of the colours, a little lighter or darker."""
    return np.asarray(rng.uniform(0.75, 1.3) * np.array(colours[rng.integers(len(colours))]))


def _look(rng: np.random.Generator) -> Look:
    skin, hair = SKIN[rng.choice(3, p=(0.6, 0.25, 0.15))], HAIR[rng.integers(len(HAIR))]
    skirt, rucksack, bag, long_hair = rng.random(4) < (0.2, 0.25, 0.35, 0.4)
    coat, trousers = _clothes(rng, COATS), _clothes(rng, TROUSERS)
    return Look(coat, trousers, hair, skin, bool(skirt), bool(rucksack), bool(bag and not rucksack), bool(long_hair))


def _limb(
    m: MeshBuilder, joints: list[Point], radii: tuple[float, ...], class_id: int, tint: Tint, material: Material = Material.CLOTH
) -> None:
    """Tubes through the joints (m), with a radius at each."""
    for k in range(len(joints) - 1):
        tube(m, joints[k], joints[k + 1], (radii[k], radii[k + 1]), Appearance(material, class_id, 0, np.asarray(tint)), 8, 0.8)


def _head(m: MeshBuilder, x: float, z: float, class_id: int, look: Look, helmet: bool = False) -> None:
    """Neck, face and hair above the shoulders at height z: an egg of rings, the face a little ahead of the hair."""
    tube(
        m,
        (x - 0.01, 0, z - 0.02),
        (x + 0.005, 0, z + 0.09),
        (0.058, 0.052),
        Appearance(Material.CLOTH, class_id, 0, np.asarray(look.skin)),
        8,
    )
    rings = ((0.055, 0.050), (0.09, 0.074), (0.15, 0.090), (0.20, 0.093), (0.25, 0.080), (0.285, 0.045), (0.295, 0.01))
    for (z0, r0), (z1, r1) in pairwise(rings):
        at = (x + 0.02, 0.0, z + z0), (x + 0.02, 0.0, z + z1)
        appearance = Appearance(Material.CLOTH, class_id, 0, np.asarray(look.skin if z1 < 0.24 else look.hair))
        tube(m, *at, (r0, r1), appearance, 10, squash=0.86)
    cap = ((0.10, 0.080), (0.16, 0.100), (0.22, 0.103), (0.27, 0.080), (0.305, 0.02))
    low = -0.10 if look.long_hair else 0.10
    for (z0, r0), (z1, r1) in pairwise(cap):
        at = (x - 0.012, 0.0, z + z0), (x - 0.012, 0.0, z + z1)
        grow = 0.022 if helmet else 0.0
        appearance = Appearance(Material.PAINT if helmet else Material.CLOTH, class_id, 0, np.asarray(look.hair))
        tube(m, *at, (r0 + grow, r1 + grow), appearance, 10)
    if look.long_hair and not helmet:
        tube(
            m,
            (x - 0.05, 0, z + low),
            (x - 0.03, 0, z + 0.14),
            (0.055, 0.08),
            Appearance(Material.CLOTH, class_id, 0, np.asarray(look.hair)),
            8,
        )


def _torso(m: MeshBuilder, hip: tuple[float, float], neck: tuple[float, float], class_id: int, tint: Tint) -> None:
    """From the hip (x, z) to the neck (x, z): a jacket, broader across than deep, with its collar."""
    (hx, hz), (nx, nz) = hip, neck
    shares = (-0.16, 0.0, 0.30, 0.62, 0.84, 0.95, 1.02)
    radii = (0.182, 0.178, 0.165, 0.188, 0.200, 0.150, 0.072)
    at = [(hx + (nx - hx) * s, 0.0, hz + (nz - hz) * s) for s in shares]
    for k in range(len(at) - 1):
        # v runs down the jacket once, so that its texture's zip, pockets and hem fall into place
        tube(
            m,
            at[k],
            at[k + 1],
            (radii[k], radii[k + 1]),
            Appearance(Material.JACKET, class_id, 0, np.asarray(tint)),
            12,
            0.7,
            squash=0.60,
        )


def pedestrian(rng: np.random.Generator, phase: float) -> Mesh:
    """A person in step: phase 0 to 1 of the stride (both legs)."""
    m, cls = MeshBuilder(), CLASS_ID["person"]
    look, tall = _look(rng), rng.uniform(0.90, 1.06)
    swing = 0.40 * np.sin(2 * np.pi * phase)
    for side in (1.0, -1.0):
        a = side * swing
        knee_bend = 0.12 + 0.42 * max(0.0, -side * np.cos(2 * np.pi * phase))
        _leg(m, a, knee_bend, side, look, cls)
        _arm(m, -0.75 * a, side, look, cls)
    _torso(m, (0.0, 0.93), (0.015, 1.45), cls, look.coat)
    if look.skirt:
        tube(
            m,
            (0, 0, 0.50),
            (0, 0, 0.98),
            (0.23, 0.16),
            Appearance(Material.CLOTH, cls, 0, np.asarray(look.coat)),
            12,
            0.8,
            squash=0.7,
        )
    if look.rucksack:
        box(
            m,
            (-0.30, -0.15, 1.02),
            (-0.10, 0.15, 1.44),
            Appearance(Material.CLOTH, cls, 0, look.trousers[::-1] + 0.05),
            0.5,
            bottom=True,
        )
    if look.bag:
        box(m, (-0.14, 0.20, 0.62), (0.16, 0.30, 0.92), Appearance(Material.CLOTH, cls, 0, look.coat[::-1] * 0.8), 0.5, bottom=True)
    _head(m, 0.02, 1.45, cls, look)
    mesh = m.build()
    mesh.corners[...] *= np.float32(tall)
    return mesh


def _leg(m: MeshBuilder, a: float, knee_bend: float, side: float, look: Look, cls: int) -> None:
    """Thigh swung forward by a (rad), knee bent, shoe."""
    hip = (0.0, side * 0.085, 0.92)
    knee = (0.44 * np.sin(a + 0.4 * knee_bend), side * 0.09, 0.92 - 0.44 * np.cos(a + 0.4 * knee_bend))
    low = a - 0.6 * knee_bend
    foot = (knee[0] + 0.41 * np.sin(low), side * 0.09, max(0.08, knee[2] - 0.41 * np.cos(low)))
    calf = tuple(0.62 * np.array(knee) + 0.38 * np.array(foot))
    tint: Tint = look.skin if look.skirt else look.trousers
    _limb(m, [hip, knee], (0.098, 0.066), cls, look.trousers)
    _limb(m, [knee, calf, foot], (0.066, 0.064, 0.048), cls, tint)
    heel, toe = (foot[0] - 0.07, foot[1], foot[2] - 0.035), (foot[0] + 0.19, foot[1], max(0.035, foot[2] - 0.05))
    _limb(m, [heel, toe], (0.048, 0.040), cls, SHOE)


def _arm(m: MeshBuilder, a: float, side: float, look: Look, cls: int) -> None:
    """A sleeve swung by a (rad), slightly bent, and a hand."""
    shoulder = (0.0, side * 0.185, 1.39)
    elbow = (0.30 * np.sin(a) - 0.02, side * 0.225, 1.39 - 0.29 * np.cos(a))
    bend = a + 0.35
    hand = (elbow[0] + 0.25 * np.sin(bend), side * 0.215, elbow[2] - 0.25 * np.cos(bend))
    _limb(m, [shoulder, elbow, hand], (0.062, 0.050, 0.040), cls, look.coat)
    _limb(m, [hand, (hand[0] + 0.03, hand[1], hand[2] - 0.09)], (0.036, 0.025), cls, look.skin)


def cyclist(rng: np.random.Generator, helmet: bool) -> Mesh:
    """A person on a bicycle, one foot low."""
    m, cls, look = MeshBuilder(), CLASS_ID["rider"], _look(rng)
    hip, neck = (-0.22, 0.98), (0.146, 1.49)
    for side, low in ((1.0, 0.0), (-1.0, 0.24)):
        knee = (0.17 + 0.05 * (low > 0), side * 0.20, 0.72 + 0.65 * low)
        foot = (0.08 if low == 0 else -0.06, side * 0.14, 0.20 + low)
        _riding_limbs(m, side, (hip, neck), knee, foot, (0.34, side * 0.24, 1.07), look)
    _torso(m, hip, neck, cls, look.coat)
    if look.rucksack:
        x, z = (hip[0] + neck[0]) / 2 - 0.24, (hip[1] + neck[1]) / 2
        box(
            m,
            (x - 0.10, -0.15, z - 0.16),
            (x + 0.10, 0.15, z + 0.24),
            Appearance(Material.CLOTH, cls, 0, look.trousers[::-1] + 0.05),
            0.5,
        )
    if helmet:
        look = replace(look, hair=HELMETS[rng.integers(len(HELMETS))], long_hair=False)
    _head(m, neck[0] + 0.03, neck[1] - 0.01, cls, look, helmet)
    return m.build()


def biker(rng: np.random.Generator) -> Mesh:
    """A person on a motorcycle, in leather, with a helmet that covers the face, feet on the rests."""
    m, cls = MeshBuilder(), CLASS_ID["rider"]
    look = replace(_look(rng), coat=_clothes(rng, LEATHERS), trousers=_clothes(rng, LEATHERS), skin=SHOE)
    hip, neck = (-0.24, 0.87), (0.0, 1.38)
    for side in (1.0, -1.0):
        _riding_limbs(m, side, (hip, neck), (0.16, side * 0.25, 0.70), (-0.16, side * 0.25, 0.38), (0.34, side * 0.34, 1.07), look)
    _torso(m, hip, neck, cls, look.coat)
    _full_helmet(m, neck[0] + 0.05, neck[1], HELMETS[rng.integers(len(HELMETS))])
    return m.build()


def _riding_limbs(
    m: MeshBuilder,
    side: float,
    back: tuple[tuple[float, float], tuple[float, float]],
    knee: Point,
    foot: Point,
    hand: Point,
    look: Look,
) -> None:
    """Leg, shoe, arm and hand of one side; `back` holds x and z of hip and neck."""
    cls, (hip, neck) = CLASS_ID["rider"], back
    _limb(m, [(hip[0], side * 0.09, hip[1]), knee], (0.105, 0.072), cls, look.trousers)
    _limb(m, [knee, foot], (0.072, 0.050), cls, look.trousers)
    _limb(m, [(foot[0] - 0.08, foot[1], foot[2] - 0.03), (foot[0] + 0.17, foot[1], foot[2] - 0.04)], (0.048, 0.040), cls, SHOE)
    shoulder, elbow = (neck[0], side * 0.185, neck[1] - 0.07), (neck[0] + 0.14, side * 0.31, neck[1] - 0.28)
    _limb(m, [shoulder, elbow, hand], (0.064, 0.050, 0.040), cls, look.coat)
    _limb(m, [hand, (hand[0] + 0.06, hand[1] - side * 0.01, hand[2])], (0.042, 0.036), cls, look.skin)


def _full_helmet(m: MeshBuilder, x: float, z: float, tint: Tint) -> None:
    """A round helmet with chin and visor above the shoulders at height z."""
    cls = CLASS_ID["rider"]
    rings = ((0.0, 0.095), (0.05, 0.122), (0.12, 0.135), (0.19, 0.132), (0.25, 0.105), (0.285, 0.055), (0.295, 0.01))
    for (z0, r0), (z1, r1) in pairwise(rings):
        tube(m, (x, 0.0, z + z0), (x, 0.0, z + z1), (r0, r1), Appearance(Material.PAINT, cls, 0, np.asarray(tint)), 12, squash=0.88)
    angle = np.linspace(-1.05, 1.05, 7)
    low, high = (
        np.column_stack([x + 0.006 + r * np.cos(angle), 0.92 * r * np.sin(angle), np.full(7, z + at)])
        for r, at in ((0.138, 0.12), (0.134, 0.20))
    )
    visor = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    m.quads(visor, np.zeros((6, 4, 2)), Material.GLASS, cls)
