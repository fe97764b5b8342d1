"""People, modelled around their own origin: x forward, y left, feet on z = 0."""

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.materials import Material
from wayloom.simulation.mesh import Mesh, MeshBuilder
from wayloom.simulation.solids import tube

SKIN, HAIR = (0.75, 0.50, 0.38), ((0.05, 0.03, 0.02), (0.18, 0.10, 0.05), (0.35, 0.26, 0.14), (0.4, 0.4, 0.4))
COATS = (
    (0.03, 0.03, 0.04), (0.06, 0.08, 0.16), (0.30, 0.05, 0.05), (0.60, 0.58, 0.54), (0.22, 0.23, 0.24), (0.10, 0.16, 0.10),
    (0.45, 0.33, 0.20), (0.10, 0.22, 0.42), (0.65, 0.45, 0.08), (0.30, 0.16, 0.28), (0.80, 0.78, 0.74),
)  # fmt: skip
TROUSERS = ((0.04, 0.06, 0.13), (0.07, 0.10, 0.20), (0.02, 0.02, 0.025), (0.28, 0.23, 0.16), (0.14, 0.14, 0.15), (0.10, 0.08, 0.06))
STEP_PHASES = 8
"""How many poses a step is cut into."""


def _clothes(rng: np.random.Generator, colours: tuple[tuple[float, float, float], ...]) -> np.ndarray:
    """(3,) one of the colours, a little lighter or darker."""
    return np.asarray(rng.uniform(0.75, 1.3) * np.array(colours[rng.integers(len(colours))]))


def _limb(m: MeshBuilder, joints: list[tuple[float, float, float]], radii: tuple[float, ...], class_id: int, tint: object) -> None:
    """Tubes through the joints (m), with a radius at each."""
    for k in range(len(joints) - 1):
        tube(m, joints[k], joints[k + 1], (radii[k], radii[k + 1]), Material.CLOTH, class_id, 0, np.asarray(tint), 6, 0.8)


def _head(m: MeshBuilder, x: float, z: float, class_id: int, hair: object) -> None:
    """Neck, face and hair above the shoulders at height z."""
    tube(m, (x, 0, z), (x + 0.01, 0, z + 0.10), (0.055, 0.055), Material.CLOTH, class_id, 0, SKIN, 6)
    for low, high, r0, r1, tint in (
        (0.06, 0.13, 0.05, 0.095, SKIN),
        (0.13, 0.22, 0.095, 0.105, SKIN),
        (0.22, 0.29, 0.108, 0.085, hair),
        (0.29, 0.32, 0.085, 0.02, hair),
    ):
        tube(m, (x + 0.02, 0, z + low), (x + 0.02, 0, z + high), (r0, r1), Material.CLOTH, class_id, 0, np.asarray(tint), 8)


def _torso(m: MeshBuilder, hip: tuple[float, float], neck: tuple[float, float], class_id: int, tint: object) -> None:
    """From the hip (x, z) to the neck (x, z): broader across than deep."""
    (hx, hz), (nx, nz) = hip, neck
    at = [(hx + (nx - hx) * s, 0.0, hz + (nz - hz) * s) for s in (-0.08, 0.35, 0.82, 1.0)]
    radii = (0.17, 0.16, 0.20, 0.08)
    for k in range(3):
        tube(m, at[k], at[k + 1], (radii[k], radii[k + 1]), Material.CLOTH, class_id, 0, np.asarray(tint), 10, 0.8, squash=0.62)


def pedestrian(rng: np.random.Generator, phase: float) -> Mesh:
    """A person in step: phase 0 to 1 of the stride (both legs)."""
    m, cls = MeshBuilder(), CLASS_ID["person"]
    coat, trousers, hair = _clothes(rng, COATS), _clothes(rng, TROUSERS), HAIR[rng.integers(len(HAIR))]
    tall = rng.uniform(0.90, 1.06)
    swing = 0.42 * np.sin(2 * np.pi * phase)
    for side, way in ((1.0, 1.0), (-1.0, -1.0)):
        a = way * swing
        knee_bend = 0.25 * max(0.0, -way * np.cos(2 * np.pi * phase))
        knee = (0.45 * np.sin(a) + 0.05, side * 0.10, 0.90 - 0.44 * np.cos(a))
        foot = (knee[0] + 0.44 * np.sin(a - knee_bend), side * 0.10, max(0.06, knee[2] - 0.44 * np.cos(a - knee_bend)))
        _limb(m, [(0, side * 0.09, 0.92), knee, foot], (0.095, 0.07, 0.055), cls, trousers)
        _limb(m, [(foot[0] - 0.06, foot[1], 0.045), (foot[0] + 0.18, foot[1], 0.04)], (0.05, 0.045), cls, (0.05, 0.04, 0.03))
        elbow = (-0.28 * np.sin(a), side * 0.25, 1.16)
        _limb(
            m,
            [(0, side * 0.20, 1.42), elbow, (elbow[0] - 0.18 * np.sin(a) + 0.10, side * 0.24, 0.94)],
            (0.06, 0.048, 0.04),
            cls,
            coat,
        )
    _torso(m, (0.0, 0.92), (0.0, 1.46), cls, coat)
    _head(m, 0.0, 1.44, cls, hair)
    mesh = m.build()
    mesh.corners[...] *= np.float32(tall)
    return mesh


def rider(rng: np.random.Generator, lean: float, seat: float, helmet: bool) -> Mesh:
    """A person on two wheels: lean (m) is how far the shoulders are ahead of the seat, whose height is `seat` m."""
    m, cls = MeshBuilder(), CLASS_ID["rider"]
    coat, trousers = _clothes(rng, COATS), _clothes(rng, TROUSERS)
    hip, neck = (-0.22, seat + 0.06), (-0.22 + lean, seat + 0.58)
    for side, low in ((1.0, 0.0), (-1.0, 0.22)):
        knee, foot = (0.18, side * 0.13, seat - 0.16 + 0.5 * low), (0.0, side * 0.12, max(0.14, seat - 0.78 + low))
        _limb(m, [(hip[0], side * 0.09, hip[1]), knee, foot], (0.10, 0.075, 0.055), cls, trousers)
        _limb(m, [(foot[0] - 0.07, foot[1], foot[2]), (foot[0] + 0.16, foot[1], foot[2])], (0.05, 0.045), cls, (0.04, 0.04, 0.04))
        _limb(
            m,
            [(neck[0], side * 0.20, neck[1] - 0.06), (neck[0] + 0.14, side * 0.28, neck[1] - 0.28), (0.32, side * 0.24, 1.06)],
            (0.06, 0.048, 0.04),
            cls,
            coat,
        )
    _torso(m, hip, neck, cls, coat)
    _head(m, neck[0], neck[1] - 0.02, cls, rng.uniform(0.05, 0.8, 3) if helmet else HAIR[rng.integers(len(HAIR))])
    return m.build()
