"""Made sightings: things at exact places as drives see them, with noise of the covariance that they tell."""

from collections.abc import Sequence

import numpy as np

from wayloom.geometry import se3
from wayloom.objects.types import CELL_M, ObjectSightings, PlacedSightings

EXACT = np.zeros((6, 6))


def some_sightings(
    points: Sequence[Sequence[float]],
    kind: int | Sequence[int] = 0,
    sigma: float = 0.03,
    evidence: float = 2.0,
    against: float = 0.0,
    facing: Sequence[float] | None = None,
    looked: int = 9,
    name: str = "s",
) -> ObjectSightings:
    """Things at points (N, 3), in a submap that saw 100 m around."""
    n = len(points)
    side = round(100.0 / CELL_M)
    return ObjectSightings(
        submap=name,
        T_submap_level=np.eye(4),
        corner=np.full(2, -side // 2, np.int32),
        looked=np.full((side, side), looked, np.uint8),
        kind=np.broadcast_to(np.asarray(kind, np.uint8), n).copy(),
        position=np.asarray(points, np.float32).reshape(n, 3),
        covariance=np.tile(sigma**2 * np.eye(3, dtype=np.float32), (n, 1, 1)),
        bottom_m=np.zeros(n, np.float32),
        top_m=np.full(n, 3.0, np.float32),
        width_m=np.full(n, 0.1, np.float32),
        facing=np.tile(np.asarray(facing or [np.nan] * 3, np.float32), (n, 1)),
        facing_sigma=np.full(n, np.nan if facing is None else 0.1, np.float32),
        looks=np.full(n, 5, np.uint16),
        evidence_for=np.full(n, evidence, np.float32),
        evidence_against=np.full(n, against, np.float32),
        first_ns=np.full(n, 100, np.int64),
        last_ns=np.full(n, 200, np.int64),
    )


def placed(sightings: ObjectSightings, drive: str, T: np.ndarray | None = None, covariance: np.ndarray = EXACT) -> PlacedSightings:
    """Sightings at their submap's place, the origin by default."""
    return PlacedSightings(sightings, np.eye(4) if T is None else T, covariance, drive)


def of_drives(points: np.ndarray, drives: int, sigma: float, seed: int = 0) -> list[PlacedSightings]:
    """The same things (N, 3) as so many drives see them: each in a submap that lies elsewhere, with noise of sigma."""
    rng, out = np.random.default_rng(seed), []
    for number in range(drives):
        T = se3.exp(np.array([*rng.normal(0.0, 5.0, 2), 0.0, 0.0, 0.0, rng.uniform(-3.0, 3.0)]))
        seen = points + rng.normal(0.0, sigma, points.shape)
        out.append(placed(some_sightings(se3.transform(se3.inverse(T), seen), sigma=sigma, name=str(number)), f"drive-{number}", T))
    return out
