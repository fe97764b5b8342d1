"""Change: what has gone from a street and what is new, judged of whole things by the drives that saw them and that saw through.

A drive *has* a thing of which it has points, or that several of its looks see and fewer deny. The looks of the others, each from a
place of its own, are odds that *nothing is there*; those of all drives that come after all that have a thing add up, and when they
suffice it is gone. It is new when those of all that came before do. All else stays: who looks elsewhere, or cannot tell, says
nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import MOVING, THIN
from wayloom.stitching.change_types import KINDS, Change
from wayloom.stitching.evidence import log_odds
from wayloom.stitching.fusion import FusedPoints
from wayloom.stitching.layer_names import GONE, PARKED, STATIC, UNCONFIRMED
from wayloom.stitching.placed_looks import PlacedLooks
from wayloom.stitching.points import Box, MapPoints
from wayloom.stitching.settings import ChangeSettings
from wayloom.stitching.sightings import EVER_NS, NEVER_NS, Sightings, sightings_of
from wayloom.stitching.things import Things, find_things

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
GONE_KIND: Final = KINDS[0]


@dataclass(frozen=True)
class _Drives:
    """Of D drives and T things: whether a drive has a thing, since when and until when; its log-odds that nothing is there."""

    has: NDArray[np.bool_]
    first_ns: IntArray
    last_ns: IntArray
    odds: FloatArray
    sights: Sightings

    @cached_property
    def since(self) -> IntArray:
        """(T,) ns: when a drive first had each thing."""
        return np.asarray(np.where(self.has, self.first_ns, EVER_NS).min(axis=0, initial=EVER_NS))

    @cached_property
    def until(self) -> IntArray:
        """(T,) ns: when one last had it."""
        return np.asarray(np.where(self.has, self.last_ns, NEVER_NS).max(axis=0, initial=NEVER_NS))

    def witnesses(self, kind: str) -> NDArray[np.bool_]:
        """(D, T) drives that have not a thing and whose looks that saw it or through it, at least one, all come after those of all
        that have it ("gone"), or before ("new"). Bare looks carry no time and count with these."""
        return self._after if kind == GONE_KIND else self._before

    @cached_property
    def _after(self) -> NDArray[np.bool_]:
        first = np.minimum(self.sights.first_seen, self.sights.first_through)
        return np.asarray(~self.has & (first > self.until) & self._has_word)

    @cached_property
    def _before(self) -> NDArray[np.bool_]:
        last = np.maximum(self.sights.last_seen, self.sights.last_through)
        return np.asarray(~self.has & (last < self.since) & self._has_word)

    @property
    def _has_word(self) -> NDArray[np.bool_]:
        return np.asarray(self.sights.seen + self.sights.through > 0)


def judge_change(
    points: MapPoints,
    fused: FusedPoints,
    layer: NDArray[np.int8],
    looks: Sequence[PlacedLooks],
    box: Box,
    settings: ChangeSettings,
) -> tuple[NDArray[np.int8], list[Change]]:
    """The layers (P,) after the change, and the changes whose middle lies in the core of the box, by place.

    Changes are those of things of `listed_points` and more, and of posts and signs, of which a small image may give no more than
    one; a smaller thing that is gone leaves the layers all the same.

    layer : (P,) before; looks : canonical, all whose cameras lie within `see_m` of the box
    """
    xyz = fused.xyz[:, :2]
    may_change = (layer == STATIC) | (layer == PARKED) | (layer == UNCONFIRMED)
    rows = np.flatnonzero(may_change & ((xyz >= box.low) & (xyz < box.high)).all(axis=1))
    things = find_things(fused.xyz, points.label, rows, settings.link_m, settings.thing_m)
    drives = _drives_of(things, points, sightings_of(things, points, fused, looks, settings), settings)
    gone, new, unsure = _verdicts(drives, things.kind, settings)
    out = layer.copy()
    of_point, published = things.thing, np.isin(layer[things.rows], (STATIC, PARKED))
    out[things.rows[published & gone[of_point]]] = GONE
    out[things.rows[published & unsure[of_point]]] = UNCONFIRMED
    is_listed = np.bincount(of_point[published], minlength=len(things)) > 0
    is_listed &= (np.diff(things.start) >= settings.listed_points) | (things.kind == THIN)
    found = [
        _change(kind, int(thing), things, fused, drives)
        for kind, marked in zip(KINDS, (gone, new), strict=True)
        for thing in np.flatnonzero(marked & is_listed)
    ]
    inside = [one for one in found if _holds(box, one)]
    return out, sorted(inside, key=lambda one: (one.position_enu, one.kind, one.label))


def _drives_of(things: Things, points: MapPoints, sights: Sightings, settings: ChangeSettings) -> _Drives:
    """By all drives, in the order of the sightings' and the points' ids together."""
    ids = tuple(sorted({*sights.drive_ids, *points.drive_ids}))
    place = np.array([ids.index(name) for name in sights.drive_ids], np.int64)
    shape = (len(ids), len(things))
    wide = {name: np.zeros(shape, np.int64) for name in ("seen", "through", "bare")}
    wide |= {name: np.full(shape, EVER_NS) for name in ("first_seen", "first_through")}
    wide |= {name: np.full(shape, NEVER_NS) for name in ("last_seen", "last_through")}
    for name, array in wide.items():
        array[place] = getattr(sights, name)
    all_sights = Sightings(ids, **wide)
    row_of = np.array([ids.index(name) for name in points.drive_ids], np.int64)
    drive, seen_ns = row_of[points.drive[things.rows]], points.seen_ns[things.rows]
    own, first, last = np.zeros(shape, np.int64), wide["first_seen"].copy(), wide["last_seen"].copy()
    np.add.at(own, (drive, things.thing), 1)
    np.minimum.at(first, (drive, things.thing), seen_ns)
    np.maximum.at(last, (drive, things.thing), seen_ns)
    odds = log_odds(all_sights, things.kind)
    has = (own > 0) | (wide["seen"] >= settings.looks) & (odds < 0.0)
    return _Drives(has, first, last, odds, all_sights)


def _verdicts(drives: _Drives, kind: NDArray[np.uint8], settings: ChangeSettings) -> tuple[NDArray[np.bool_], ...]:
    """(T,) gone, new, and those that would be new but that too few looks have seen.

    A thing that a drive that has it sees through is none: its points are wrong, or it is a fence. One that hardly any look has seen
    may be hard to see: of it nobody says that it is not there.
    """
    sights = drives.sights
    solid = (~drives.has | (sights.through <= settings.agreeing * sights.seen)).all(axis=0)
    plain = solid & (np.where(drives.has, sights.seen, 0).sum(axis=0) >= settings.looks)
    least = np.where(kind == MOVING, settings.least_through_vehicle, settings.least_through)
    gone, came = (plain & _nothing(drives, drives.witnesses(way), least, settings) for way in KINDS)
    came &= ~gone
    confirmed = (drives.has.sum(axis=0) >= 2) | (np.where(drives.has, sights.seen, 0) >= settings.confirming).any(axis=0)
    return gone, came & confirmed, came & ~confirmed


def _nothing(drives: _Drives, witnesses: NDArray[np.bool_], least: IntArray, settings: ChangeSettings) -> NDArray[np.bool_]:
    """(T,) whether the witnesses (D, T) together say that nothing is there: by their odds, and `least` (T,) looks see through."""
    odds, looks = (np.where(witnesses, each, 0).sum(axis=0) for each in (drives.odds, drives.sights.through))
    return np.asarray((odds >= settings.nothing_odds) & (looks >= least))


def _change(kind: str, thing: int, things: Things, fused: FusedPoints, drives: _Drives) -> Change:
    rows = things.rows[things.start[thing] : things.start[thing + 1]]
    xyz, sights = fused.xyz[rows], drives.sights
    has = np.flatnonzero(drives.has[:, thing])
    says = np.flatnonzero((drives.witnesses(kind) & (sights.through > 0))[:, thing])
    return Change(
        kind,
        int(things.label[thing]),
        _three(xyz.mean(axis=0)),
        _three(xyz.max(axis=0) - xyz.min(axis=0)),
        len(rows),
        tuple(sights.drive_ids[row] for row in has.tolist()),
        int(sights.seen[has, thing].sum()),
        int(drives.since[thing]),
        int(drives.until[thing]),
        tuple(sights.drive_ids[row] for row in says.tolist()),
        int(sights.through[says, thing].sum()),
        int(sights.first_through[says, thing].min()),
        int(sights.last_through[says, thing].max()),
    )


def _three(values: FloatArray) -> tuple[float, float, float]:
    east, north, up = np.round(values, 3).tolist()
    return east, north, up


def _holds(box: Box, change: Change) -> bool:
    at = np.array(change.position_enu[:2])
    return bool(((at >= box.core_low) & (at < box.core_high)).all())
