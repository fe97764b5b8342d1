"""Sightings of all drives in the map's frame, in one canonical order, so that nothing depends on the order of arrival."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.objects.types import ObjectSightings, PlacedSightings

FloatArray = NDArray[np.float64]
LEAST_VARIANCE: Final = 1e-6
"""m^2 that every position has at least, so that covariances can be inverted."""


@dataclass(frozen=True, slots=True)
class AllSightings:
    """M sightings of P placed submaps, in the map's frame, by drive, digest and row.

    source      (M,) which of `placed`; row (M,) which of its things
    drive       (M,) row of drives
    kind        (M,)
    position    (M, 3) m, enu
    own         (M, 3, 3) m^2, enu: covariance relative to the submap
    place       (M, 3, 3) m^2, enu: covariance of the submap's place, there
    """

    placed: tuple[PlacedSightings, ...]
    drives: tuple[str, ...]
    source: NDArray[np.int64]
    row: NDArray[np.int64]
    drive: NDArray[np.int64]
    kind: NDArray[np.int64]
    position: FloatArray
    own: FloatArray
    place: FloatArray

    def __len__(self) -> int:
        return len(self.kind)

    def column(self, name: str) -> NDArray[np.generic]:
        """(M, ...) a column of the sightings."""
        empty = getattr(NOTHING, name)[:0]
        return np.concatenate([empty, *(getattr(one.sightings, name) for one in self.placed)])

    @property
    def total(self) -> FloatArray:
        """(M, 3, 3) m^2: covariance in the map."""
        return self.own + self.place


def canonical(sightings: Iterable[PlacedSightings]) -> tuple[PlacedSightings, ...]:
    """Each submap's sightings of each drive once, by drive and digest."""
    by_name = {(one.drive_id, one.sightings.digest): one for one in sightings}
    return tuple(by_name[name] for name in sorted(by_name))


def all_sightings(sightings: Sequence[PlacedSightings]) -> AllSightings:
    """What the drives saw, in the map's frame."""
    placed = canonical(sightings)
    drives = tuple(sorted({one.drive_id for one in placed}))
    counts = [len(one.sightings) for one in placed]
    source = np.repeat(np.arange(len(placed)), counts)
    parts = [_in_map(one) for one in placed]
    return AllSightings(
        placed=placed,
        drives=drives,
        source=source,
        row=np.concatenate([np.zeros(0, np.int64), *(np.arange(count) for count in counts)]),
        drive=np.array([drives.index(one.drive_id) for one in placed], np.int64)[source],
        kind=np.concatenate([np.zeros(0, np.int64), *(one.sightings.kind for one in placed)]),
        position=np.concatenate([np.zeros((0, 3)), *(part[0] for part in parts)]),
        own=np.concatenate([np.zeros((0, 3, 3)), *(part[1] for part in parts)]),
        place=np.concatenate([np.zeros((0, 3, 3)), *(part[2] for part in parts)]),
    )


def _in_map(one: PlacedSightings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions and both covariances. A left perturbation (v, omega) moves p by v + omega x p: J = [I, -hat(p)]."""
    R = one.T_enu_submap[:3, :3]
    position = se3.transform(one.T_enu_submap, one.sightings.position.astype(np.float64))
    own = R @ one.sightings.covariance.astype(np.float64) @ R.T + LEAST_VARIANCE * np.eye(3)
    covariance = one.covariance if np.isfinite(one.covariance).all() else np.zeros((6, 6))
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(position), 3, 3)), -se3.hat(position)], axis=2)
    return position, own, J @ covariance @ J.transpose(0, 2, 1)


NOTHING: Final = ObjectSightings(
    submap="", T_submap_level=np.eye(4), corner=np.zeros(2, np.int32), looked=np.zeros((0, 0), np.uint8),
    kind=np.zeros(0, np.uint8), position=np.zeros((0, 3), np.float32), covariance=np.zeros((0, 3, 3), np.float32),
    bottom_m=np.zeros(0, np.float32),
    top_m=np.zeros(0, np.float32), width_m=np.zeros(0, np.float32), facing=np.zeros((0, 3), np.float32),
    facing_sigma=np.zeros(0, np.float32), looks=np.zeros(0, np.uint16), evidence_for=np.zeros(0, np.float32),
    evidence_against=np.zeros(0, np.float32), first_ns=np.zeros(0, np.int64), last_ns=np.zeros(0, np.int64),
)  # fmt: skip
"""Of a submap along which nothing was seen."""
