"""Alignment of the drives of a map: what those that meet have in common, and where the city graph puts their submaps.

The places depend on the set of drives and of what pairs of them have in common (`wayloom_workers.drive_pairs`): neither the order
of arrival nor what was in the map before changes them. Guests, drives that are held for their place, are asked with them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.gate import gate_of
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.uncertainty import moved_covariance, moved_cross
from wayloom.stitching.admission import ALONE, UNKNOWN, Verdict, admit
from wayloom.stitching.drive_chain import own_covariance
from wayloom.stitching.meeting_files import decode_meetings
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import City, DrivePlaces, Meeting
from wayloom.store import maps, meetings
from wayloom.store.map_versions import MovedSubmap
from wayloom.store.tables.drives import SubmapRow
from wayloom.store.tables.maps import MeetingRow
from wayloom.submaps.submap import PlacedSubmap, StepBefore, decode_submap
from wayloom_workers.drive_pairs import Candidates, register_pairs
from wayloom_workers.stage_hooks import StageAttempt

FloatArray = NDArray[np.float64]
STEP_M: Final = 1e-3
STEP_RAD: Final = 1e-5
"""Places of the city graph are rounded to these, so that what changes by less changes no region."""
OUT_OF_REACH: Final = "it lies too far from the map's origin for one grid"
NOBODY: Final = "the map has no drive that it could meet"
UNTOLD: Final = StepBefore(np.full((6, 6), np.nan), True)
"""Of drives that were processed before they told it: the city graph derives it."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """moved: the submaps that are to lie elsewhere than their rows have them. facts: of the version, JSON-ready. verdicts: on the
    guests that were asked, by their ids."""

    moved: tuple[MovedSubmap, ...]
    facts: dict[str, Any]
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)


NOTHING: Final = Alignment((), {})


def align(attempt: StageAttempt, frame: MapFrame, changed: Sequence[str], candidates: Candidates) -> Alignment:
    """The places of all drives that hang together with the changed ones, and whether the guests among them are admitted.

    changed : ids of drives that came, went or were placed anew
    """
    if not changed:
        return NOTHING
    map_id = str(attempt.claim.map_id)
    alike = register_pairs(attempt, frame, changed, candidates)
    asked = {*changed, *candidates.loose}  # whom a drive without a place is like depends on all that are there
    with attempt.context.database.read() as session:
        linked = [row for row in meetings.component(session, map_id, asked) if _is_heard(row, alike)]
        ids = ({name for row in linked for name in (row.drive_a, row.drive_b)} | asked) & candidates.reached
        rows = {drive_id: maps.submaps_of(session, drive_id) for drive_id in sorted(ids)}
    pairs = [row for row in linked if {row.drive_a, row.drive_b} <= ids]
    found = [decode_meetings(attempt.context.blobs.get(row.digest), row.digest) for row in pairs]
    city, verdicts = _admitted(attempt, frame, rows, [one for pair in found for one in pair.meetings], candidates)
    outside = OUT_OF_REACH if candidates.reached - candidates.guests else NOBODY
    beyond = sorted(asked & candidates.guests - candidates.reached)
    with attempt.context.database.read() as session:
        rows |= {drive_id: maps.submaps_of(session, drive_id) for drive_id in beyond}
    verdicts |= {name: Verdict(False, outside) for name in beyond}
    moved = [item for drive_id, own in rows.items() for item in _moved(attempt, frame, own, city, drive_id)]
    return Alignment(tuple(moved), _facts(city, verdicts), verdicts)


def _is_heard(row: MeetingRow, alike: Mapping[str, frozenset[str]]) -> bool:
    """Whether the pair counts: a drive without a place is heard with those that it is most like, whichever were compared before."""
    pair = ((row.drive_a, row.drive_b), (row.drive_b, row.drive_a))
    return all(one not in alike or other in alike[one] for one, other in pair)


def _admitted(
    attempt: StageAttempt,
    frame: MapFrame,
    rows: Mapping[str, Sequence[SubmapRow]],
    found: Sequence[Meeting],
    candidates: Candidates,
) -> tuple[City, dict[str, Verdict]]:
    """The city of these drives. One whose own covariance is none stays out of it, with its meetings."""
    settings = attempt.context.settings
    given = [_places(drive_id, own, frame, settings.city_graph) for drive_id, own in rows.items() if own]
    usable = {one.drive_id: one for one in given if _is_positive(one.covariance)}
    heard = [
        one for one in found
        if one.drive_a in usable and one.drive_b in usable
        and one.submap_a < len(usable[one.drive_a]) and one.submap_b < len(usable[one.drive_b])
    ]  # fmt: skip
    members = [one for name, one in usable.items() if name not in candidates.guests]
    guests = [one for name, one in usable.items() if name in candidates.guests]
    city, verdicts = admit(members, guests, heard, settings.city_graph, lambda grade: gate_of(grade, settings.gate) == "merge")
    silent = {name: Verdict(False, UNKNOWN if name in candidates.loose else ALONE) for name in rows.keys() & candidates.guests}
    return city, silent | verdicts


def _places(drive_id: str, rows: Sequence[SubmapRow], frame: MapFrame, settings: CityGraphSettings) -> DrivePlaces:
    own, length_m = np.array([_own_T(row) for row in rows]), np.array([max(row.length_m, 1.0) for row in rows])
    steps = [UNTOLD if row.step_before is None else StepBefore.of(row.step_before) for row in rows[1:]]
    connected = np.array([step.connected for step in steps], np.bool_)
    if not rows[0].located:
        return DrivePlaces(drive_id, own, own_covariance(own, length_m, settings), length_m, connected, located=False)
    T_map_cell = wgs84.T_enu_enu(frame, _cell(rows[0]))
    covariance = moved_covariance(T_map_cell, np.array([_own_covariance(row) for row in rows]))
    cross = moved_cross(T_map_cell, np.array([step.cross for step in steps]).reshape(-1, 6, 6))
    return DrivePlaces(drive_id, T_map_cell @ own, covariance, length_m, connected, cross)


def _cell(row: SubmapRow) -> MapFrame:
    """The frame of a row that has a place."""
    assert row.frame is not None
    return MapFrame(*row.frame)


def _is_positive(covariance: FloatArray) -> bool:
    return bool((np.linalg.eigvalsh(covariance) > 0.0).all())


def _moved(attempt: StageAttempt, frame: MapFrame, rows: Sequence[SubmapRow], city: City, drive_id: str) -> Iterable[MovedSubmap]:
    """The submaps of a drive that lie elsewhere than their rows say, by the city graph or, without meetings, by the drive.

    A drive without GNSS that the city has lies in the map's frame; one that it has not loses its place.
    """
    if not rows:
        return
    placed = city.drives.get(drive_id)
    placed = placed if placed is not None and placed.placed else None
    cell = _cell(rows[0]) if rows[0].located else None if placed is None else frame
    T_cell_map = np.eye(4) if cell is None else wgs84.T_enu_enu(cell, frame)
    for number, row in enumerate(rows):
        T, covariance = _own_T(row), _own_covariance(row)
        if placed is not None:
            T = rounded_place(T_cell_map @ placed.T_map_submap[number], T)
            covariance = rounded_covariance(moved_covariance(T_cell_map, placed.covariance[number][None])[0], T)
        place = T.tolist(), covariance.tolist(), _origin(cell)
        if place != (row.T_enu_submap, row.covariance, row.frame):
            yield _moved_to(attempt, row, T, covariance, cell)


def _moved_to(attempt: StageAttempt, row: SubmapRow, T: FloatArray, covariance: FloatArray, cell: MapFrame | None) -> MovedSubmap:
    """The submap with this place in a cell's frame, or, in its drive's own, without any."""
    own = row.own_T_enu_submap or row.T_enu_submap
    moved = partial(MovedSubmap, row.drive_id, row.position, row.digest, own, T.tolist(), covariance.tolist())
    if cell is None:
        return moved(track=[], frame=None, box=None)
    submap = decode_submap(attempt.context.blobs.get(row.digest), row.digest)
    placed = PlacedSubmap(submap, T, covariance, row.drive_id, cell)
    track = wgs84.lonlatheight_from_enu(placed.track_enu(), cell)[:, :2]
    points = wgs84.lonlatheight_from_enu(placed.points_enu(), cell)[:, :2]
    return moved(track=track.tolist(), frame=_origin(cell), box=box_of(np.vstack([track, points])))


def _origin(cell: MapFrame | None) -> list[float] | None:
    return None if cell is None else [cell.lon_deg, cell.lat_deg, cell.height_m]


def rounded_place(T: FloatArray, T_own: FloatArray) -> FloatArray:
    """T (4, 4) with its place rounded to STEP_M, and its rotation against T_own's as a rotation vector to STEP_RAD."""
    turned = se3.log(se3.from_rotation_translation(T[:3, :3] @ T_own[:3, :3].T, np.zeros(3)))[3:]
    steps = np.concatenate([np.zeros(3), np.rint(turned / STEP_RAD) * STEP_RAD])
    return np.asarray(se3.from_rotation_translation(se3.exp(steps)[:3, :3] @ T_own[:3, :3], np.rint(T[:3, 3] / STEP_M) * STEP_M))


def rounded_covariance(covariance: FloatArray, T: FloatArray) -> FloatArray:
    """(6, 6) of the left perturbation of T with sigmas of two figures and correlations of two decimals about T's own place, where
    they are small; rounded up, so that no sigma there is less than before by more than a hundredth."""
    here = np.eye(4)
    here[:3, 3] = -T[:3, 3]
    local = moved_covariance(here, covariance[None])[0]
    sigma = np.sqrt(np.diag(local))
    digits = 10.0 ** (np.floor(np.log10(sigma)) - 1.0)
    rounded = np.ceil(sigma / digits) * digits
    values, vectors = np.linalg.eigh(np.rint(100.0 * local / np.outer(sigma, sigma)) / 100.0)
    correlation = (vectors * np.maximum(values, 0.01)) @ vectors.T
    out = correlation * np.outer(rounded, rounded)
    return np.asarray(moved_covariance(se3.inverse(here), 0.5 * (out + out.T)[None])[0])


def _own_T(row: SubmapRow) -> FloatArray:
    return np.array(row.own_T_enu_submap or row.T_enu_submap, np.float64)


def _own_covariance(row: SubmapRow) -> FloatArray:
    return np.array(row.own_covariance or row.covariance, np.float64)


def _facts(city: City, verdicts: Mapping[str, Verdict]) -> dict[str, Any]:
    """What a reader of the version asks: how much drives that meet were moved, what became of their meetings, and which drives of
    uncertain place were admitted by them."""
    if not city.drives and not verdicts:
        return {}
    refused: dict[str, int] = {}
    for one in city.meetings:
        if one.refused:
            refused[one.refused] = refused.get(one.refused, 0) + 1
    shifts = {name: float(np.median(np.linalg.norm(drive.shift_m, axis=1))) for name, drive in sorted(city.drives.items())}
    return {
        "aligned": {
            "meetings": len(city.meetings),
            "refused": dict(sorted(refused.items())),
            "moved_m": {name: round(shift, 3) for name, shift in shifts.items() if np.isfinite(shift)},
            "admitted": {name: verdict.reason for name, verdict in sorted(verdicts.items()) if verdict.admitted},
            "held": {name: verdict.reason for name, verdict in sorted(verdicts.items()) if not verdict.admitted},
        }
    }
