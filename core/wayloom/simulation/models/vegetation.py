"""Tree, bush and hedge models made of trunks and foliage cards."""

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.models.mesh import MeshBuilder
from wayloom.simulation.models.solids import Appearance, box, cards, tube
from wayloom.simulation.textures.materials import Material

VEGETATION = CLASS_ID["vegetation"]
CARDS_PER_TREE = 90
BRANCHES = 4
HEDGE_CARDS_PER_M = 6


def _crown(m: MeshBuilder, rng: np.random.Generator, centre: np.ndarray, radii: np.ndarray, big: float, number: int) -> None:
    """Sprays of leaves through an ellipsoid, denser and lighter outside."""
    count = int(CARDS_PER_TREE * big)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    out = rng.uniform(0.35, 1.0, count) ** 0.6
    facing = 0.8 * way + (0.0, 0.0, 0.35)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    tone = np.array([rng.uniform(0.8, 1.35), rng.uniform(0.85, 1.15), rng.uniform(0.8, 1.0)])
    tints = tone * ((0.5 + 0.5 * out) * rng.uniform(0.85, 1.15, count))[:, None]
    sizes = rng.uniform(0.55, 0.95, count) * big**0.5
    cards(m, rng, centre + way * out[:, None] * radii, sizes, facing, Appearance(Material.LEAVES, VEGETATION, number, tints))


def broadleaf(m: MeshBuilder, rng: np.random.Generator, x: float, y: float, number: int, big: float = 1.0) -> None:
    """A street tree: trunk of 2.2 to 3.2 m times `big`, branches, round crown."""
    trunk = rng.uniform(2.2, 3.2) * big
    lean = rng.normal(0, 0.08, 2)
    top = np.array([x + lean[0], y + lean[1], trunk + 1.2])
    tube(m, (x, y, -0.2), top, (0.17 * big, 0.09 * big), Appearance(Material.BARK, VEGETATION, number), sides=7, metres=1.0)
    radius = rng.uniform(1.7, 2.6) * big
    for _ in range(BRANCHES):
        turn = rng.random() * 2 * np.pi
        end = (x + 0.6 * radius * np.cos(turn), y + 0.6 * radius * np.sin(turn), trunk + rng.uniform(0.8, 2.0) * big)
        tube(
            m,
            (x, y, 0.8 * trunk),
            end,
            (0.07 * big, 0.03 * big),
            Appearance(Material.BARK, VEGETATION, number),
            sides=4,
            metres=1.0,
        )
    _crown(m, rng, np.array([x, y, trunk + 0.75 * radius]), radius * np.array([1.0, 1.0, 0.8]), big, number)


def conifer(m: MeshBuilder, rng: np.random.Generator, x: float, y: float, number: int, big: float = 1.0) -> None:
    """A spruce: a cone of needles on a thin trunk."""
    height, foot = rng.uniform(7, 10) * big, rng.uniform(1.5, 2.1) * big
    tube(
        m,
        (x, y, -0.2),
        (x, y, height * 0.9),
        (0.15 * big, 0.03),
        Appearance(Material.BARK, VEGETATION, number),
        sides=6,
        metres=1.0,
    )
    count = int(CARDS_PER_TREE * 1.3 * big)
    share, turn = rng.random(count) ** 1.4, rng.random(count) * 2 * np.pi
    radius = foot * (1 - share) * rng.uniform(0.5, 1.0, count)
    centres = np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn), 0.8 + share * (height - 0.8)])
    facing = np.column_stack([np.cos(turn) * 0.9, np.sin(turn) * 0.9, np.full(count, 0.45)])
    tints = np.array([1.1, 1.15, 1.1]) * rng.uniform(0.7, 1.3, count)[:, None]
    cards(m, rng, centres, 0.35 + 0.55 * (1 - share), facing, Appearance(Material.NEEDLES, VEGETATION, number, tints))


def bush(m: MeshBuilder, rng: np.random.Generator, x: float, y: float, number: int, big: float = 1.0) -> None:
    """A round bush about a metre high times `big`."""
    count = int(22 * big)
    way = rng.normal(size=(count, 3)) * (0.45, 0.45, 0.28) * big
    facing = way / np.linalg.norm(way, axis=1, keepdims=True) * 0.7 + (0, 0, 0.5)
    tints = np.array([rng.uniform(0.8, 1.3), 1.0, 0.9]) * rng.uniform(0.7, 1.2, count)[:, None]
    sizes = rng.uniform(0.3, 0.5, count) * big**0.5
    cards(m, rng, way + np.array([x, y, 0.5 * big]), sizes, facing, Appearance(Material.LEAVES, VEGETATION, number, tints))


def hedge(m: MeshBuilder, rng: np.random.Generator, a: np.ndarray, b: np.ndarray, number: int, height: float) -> None:
    """A clipped hedge from a to b (2,) m, with twigs that stick out."""
    along = b - a
    length, yaw = float(np.hypot(*along)), float(np.arctan2(along[1], along[0]))
    box(
        m,
        (0, -0.32, -0.2),
        (length, 0.32, height),
        Appearance(Material.HEDGE, VEGETATION, number, (1, 1, 1)),
        1.5,
        (a[0], a[1]),
        yaw,
    )
    count = int(length * HEDGE_CARDS_PER_M)
    t, side = rng.random(count), rng.uniform(-0.34, 0.34, count)
    unit = along / length
    xy = a + t[:, None] * along + side[:, None] * np.array([-unit[1], unit[0]])
    z = np.where(rng.random(count) < 0.6, height + rng.normal(0, 0.05, count), rng.uniform(0.3, height, count))
    facing = np.tile((0.0, 0.0, 1.0), (count, 1))
    cards(
        m,
        rng,
        np.column_stack([xy, z]),
        rng.uniform(0.18, 0.3, count),
        facing,
        Appearance(Material.LEAVES, VEGETATION, number, (0.9, 0.9, 0.8)),
    )
