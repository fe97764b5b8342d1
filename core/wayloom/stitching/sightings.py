"""Sightings: what the looks of each drive say of things and of points."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import DEPTHS_M, MOVING
from wayloom.geometry import se3
from wayloom.stitching.fusion import FusedPoints
from wayloom.stitching.kernels import sight
from wayloom.stitching.placed_looks import PlacedLooks
from wayloom.stitching.points import MapPoints
from wayloom.stitching.settings import ChangeSettings
from wayloom.stitching.things import Things, kinds_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
INVERSE_DEPTHS: Final = np.concatenate([[0.0], 1.0 / DEPTHS_M, [0.0]])
"""(256,) 1/m of the codes."""
WORDS: Final = (sight.AGREES, sight.THROUGH, sight.PAST, sight.BARE)
NEVER_NS, EVER_NS = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True)
class Sightings:
    """Of T things and D drives that looked, in the order of drive_ids: looks that saw a thing, and those that saw through it.

    seen, through            (D, T) counts of looks
    bare                     (D, T) count of others: depth does not tell, but they found nothing of its kind
    first_seen, last_seen    (D, T) int64 ns of those that saw it, EVER_NS and NEVER_NS without one; likewise first_through,
                             last_through
    """

    drive_ids: tuple[str, ...]
    seen: IntArray
    through: IntArray
    bare: IntArray
    first_seen: IntArray
    last_seen: IntArray
    first_through: IntArray
    last_through: IntArray


def look_at_points(
    item: PlacedLooks, points: MapPoints, fused: FusedPoints, rows: IntArray, settings: ChangeSettings
) -> NDArray[np.uint8]:
    """(N, R) words of `wayloom.stitching.kernels.sight` of each look on the points of these rows (R,)."""
    out = np.zeros((len(item), len(rows)), np.uint8)
    c = item.looks.camera
    variance = np.trace(points.common[rows], axis1=1, axis2=2) + points.across2[rows]
    limits = np.array([settings.see_m, settings.gate_sigma, settings.slack_m, item.looks.sigma])
    sight.look_at(
        fused.xyz[rows],
        variance,
        kinds_of(points.label[rows]),
        se3.inverse(item.T_map_cam),
        item.variance,
        np.array([c.fx, c.fy, c.cx, c.cy]),
        item.looks.near,
        item.looks.far,
        item.looks.kinds,
        INVERSE_DEPTHS,
        limits,
        out,
    )
    return out


def sightings_of(
    things: Things, points: MapPoints, fused: FusedPoints, looks: Sequence[PlacedLooks], settings: ChangeSettings
) -> Sightings:
    """What canonical looks say of things. A look sees through a thing where it does through `share` of the points of which it has a
    word; else it sees the thing where it agrees with one. Past a vehicle to another one counts as through: stereo misses none."""
    drive_ids = tuple(sorted({item.drive_id for item in looks}))
    shape = (len(drive_ids), len(things))
    seen, through, bare = (np.zeros(shape, np.int64) for _ in range(3))
    is_vehicle = things.kind == MOVING
    first = [np.full(shape, EVER_NS) for _ in range(2)]
    last = [np.full(shape, NEVER_NS) for _ in range(2)]
    for item in looks:
        drive = drive_ids.index(item.drive_id)
        words = look_at_points(item, points, fused, things.rows, settings)
        agrees, passes, pasts, empty = (_by_thing(words == word, things.start) for word in WORDS)
        passes = passes + np.where(is_vehicle, pasts, 0)
        is_through = (passes > 0) & (passes >= settings.share * (agrees + passes))
        is_seen = (agrees > 0) & ~is_through
        bare[drive] += ((empty > 0) & ~is_seen & ~is_through).sum(axis=0)
        for counts, found, which in ((seen, is_seen, 0), (through, is_through, 1)):
            counts[drive] += found.sum(axis=0)
            times = np.where(found, item.t_ns[:, None], EVER_NS).min(axis=0, initial=EVER_NS)
            first[which][drive] = np.minimum(first[which][drive], times)
            times = np.where(found, item.t_ns[:, None], NEVER_NS).max(axis=0, initial=NEVER_NS)
            last[which][drive] = np.maximum(last[which][drive], times)
    return Sightings(drive_ids, seen, through, bare, first[0], last[0], first[1], last[1])


def _by_thing(marked: NDArray[np.bool_], start: IntArray) -> IntArray:
    """(N, T) sums of marks (N, R) over the points of each thing, none of them empty."""
    return np.asarray(
        np.add.reduceat(marked.astype(np.int64), start[:-1], axis=1) if marked.shape[1] else marked[:, :0].astype(int)
    )
