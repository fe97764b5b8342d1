"""Alignment of the drives of a map: which drives meet, what their registrations measure, and where the city graph puts submaps.

What two drives have in common depends on the two alone and is kept; the places depend on the set of drives and of what pairs of
them have in common. So neither the order of arrival nor what was in the map before changes them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import structlog
from numpy.typing import NDArray

from wayloom.errors import WayloomError
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.digests import sha256_of_json
from wayloom.places.files import load_places
from wayloom.stitching.city_graph import optimise_city
from wayloom.stitching.meeting_files import decode_meetings, encode_meetings
from wayloom.stitching.meetings import find_meetings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.types import City, DrivePlaces, Meeting
from wayloom.store import jobs, maps, meetings
from wayloom.store.map_versions import MovedSubmap
from wayloom.store.tables import MeetingRow, SubmapRow
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap, decode_submap
from wayloom_workers.stage_hooks import StageAttempt

log = structlog.get_logger()
FloatArray = NDArray[np.float64]
NEAR_M: Final = 60.0
"""Around a drive's own points, others are looked for: how far apart two drives may be placed that see the same street."""
SIGMAS: Final = 3.0
FARTHEST_M: Final = 500.0
STEP_M: Final = 1e-3
STEP_RAD: Final = 1e-5
"""Places of the city graph are rounded to these, so that what changes by less changes no region."""
SHARE: Final = 0.4
"""Of the progress, when all is aligned."""
HELD_DRIVES: Final = 4


@dataclass(frozen=True, slots=True)
class Alignment:
    """moved: the submaps that are to lie elsewhere than their rows have them. facts: of the version, JSON-ready."""

    moved: tuple[MovedSubmap, ...]
    facts: dict[str, Any]


NOTHING: Final = Alignment((), {})


def align(attempt: StageAttempt, frame: MapFrame, changed: Sequence[str], within: frozenset[tuple[str, int]]) -> Alignment:
    """The places of all drives that hang together with the changed ones.

    changed : ids of drives that came, went or were placed anew
    within  : the submaps (drive, position) that the map's frame reaches
    """
    if not changed:
        return NOTHING
    map_id = str(attempt.claim.map_id)
    reached = {drive_id for drive_id, _ in within}
    _register_pairs(attempt, frame, [drive_id for drive_id in changed if drive_id in reached], reached)
    with attempt.context.database.read() as session:
        linked = meetings.component(session, map_id, changed)
        ids = ({name for row in linked for name in (row.drive_a, row.drive_b)} | set(changed)) & reached
        rows = {drive_id: maps.submaps_of(session, drive_id) for drive_id in sorted(ids)}
    pairs = [row for row in linked if {row.drive_a, row.drive_b} <= ids]
    found = [decode_meetings(attempt.context.blobs.get(row.digest), row.digest) for row in pairs]
    city = _optimised(attempt, frame, rows, [one for pair in found for one in pair.meetings])
    moved = [item for drive_id, own in rows.items() for item in _moved(attempt, frame, own, city, drive_id)]
    return Alignment(tuple(moved), _facts(city))


def _register_pairs(attempt: StageAttempt, frame: MapFrame, changed: Sequence[str], reached: set[str]) -> None:
    """Register each changed drive with those near it, where that was not done before. What is found is kept at once."""
    load = lru_cache(HELD_DRIVES)(lambda drive_id: _placed_drive(attempt, frame, drive_id))
    pairs = _near_pairs(attempt, changed, reached)
    for count, (a, b) in enumerate(pairs):
        attempt.progress(SHARE * count / len(pairs), f"pair {count + 1} of {len(pairs)} drives")
        inputs = _inputs(attempt, frame, a, b)
        with attempt.context.database.read() as session:
            known = session.get(MeetingRow, (str(attempt.claim.map_id), a, b))
        if inputs is None or (known is not None and known.inputs == inputs and attempt.context.blobs.has(known.digest)):
            continue
        one, other = load(a), load(b)
        if one is None or other is None:
            continue
        found = find_meetings(one, other, attempt.context.settings.meetings)
        digest = attempt.context.blobs.put(encode_meetings(found))
        log.info("drives compared", drive_a=a[:12], drive_b=b[:12], meetings=len(found.meetings), tried=found.report["tried"])
        row = MeetingRow(
            map_id=str(attempt.claim.map_id), drive_a=a, drive_b=b, inputs=inputs, digest=digest, count=len(found.meetings)
        )
        with attempt.context.database.write() as session:
            meetings.keep(session, [row])


def _near_pairs(attempt: StageAttempt, changed: Sequence[str], reached: set[str]) -> list[tuple[str, str]]:
    """Pairs of a changed drive with one that may have seen the same street, the lesser id first, sorted."""
    pairs: set[tuple[str, str]] = set()
    with attempt.context.database.read() as session:
        for drive_id in changed:
            for row in maps.submaps_of(session, drive_id):
                for other in maps.drives_near(session, str(attempt.claim.map_id), _wide_box(row)):
                    if other != drive_id and other in reached:
                        pairs.add((min(drive_id, other), max(drive_id, other)))
    return sorted(pairs)


def _wide_box(row: SubmapRow) -> maps.Box:
    """Degrees around a submap, as far as its own place is uncertain and more."""
    sigma = float(np.sqrt(np.clip(np.linalg.eigvalsh(_own_covariance(row)[:3, :3])[-1], 0.0, None)))
    margin_m = min(NEAR_M + SIGMAS * sigma, FARTHEST_M)
    south, north = row.min_lat, row.max_lat
    lat = np.degrees(margin_m / 6_350_000.0)
    lon = lat / max(np.cos(np.radians(max(abs(south), abs(north)))), 1e-3)
    return row.min_lon - lon, south - lat, row.max_lon + lon, north + lat


def _inputs(attempt: StageAttempt, frame: MapFrame, a: str, b: str) -> str | None:
    """Digest of all that the meetings of two drives depend on; None where one was processed before there were places."""
    with attempt.context.database.read() as session:
        keys = [jobs.keys_of_outputs(session, drive_id, ("places", "submaps")) for drive_id in (a, b)]
    if any(len(found) < 2 for found in keys):
        return None
    return sha256_of_json({
        "drives": [a, b],
        "outputs": keys,
        "frame": [frame.lon_deg, frame.lat_deg, frame.height_m],
        "settings": attempt.context.settings.meetings.model_dump(mode="json"),
        "code": code_version("wayloom.stitching.meetings").text,
    })  # fmt: skip


def _placed_drive(attempt: StageAttempt, frame: MapFrame, drive_id: str) -> PlacedDrive | None:
    """A drive with its own places, as its stages left it; None, and a warning, where they are gone or are of different runs."""
    with attempt.context.database.read() as session:
        keys = jobs.keys_of_outputs(session, drive_id, ("places", "submaps"))
    stages = attempt.context.folders.drive(drive_id) / "stages"
    try:
        places = load_places(_only(stages / "places" / keys["places"]))
        own = load_submaps(stages / "submaps" / keys["submaps"])
        return PlacedDrive(drive_id, places, tuple(_in_frame(item, frame, drive_id) for item in own))
    except (WayloomError, KeyError) as error:
        log.warning("drive cannot be compared with others", drive_id=drive_id, error=str(error))
        return None


def _only(folder: Path) -> Path:
    """The file of places in the stage's folder."""
    return next(iter(sorted(folder.glob("*.places"))), folder / "drive.places")


def _in_frame(item: PlacedSubmap, frame: MapFrame, drive_id: str) -> PlacedSubmap:
    """A submap in the map's frame."""
    assert item.frame is not None
    T = wgs84.T_enu_enu(frame, item.frame)
    return PlacedSubmap(item.submap, T @ item.T_enu_submap, moved_covariance(T, item.covariance[None])[0], drive_id, frame)


def _optimised(attempt: StageAttempt, frame: MapFrame, rows: Mapping[str, Sequence[SubmapRow]], found: Sequence[Meeting]) -> City:
    """The city graph of these drives. One whose own covariance is none stays out of it, with its meetings."""
    given = [_places(drive_id, own, frame) for drive_id, own in rows.items() if own]
    usable = {one.drive_id: one for one in given if _is_positive(one.covariance)}
    heard = [
        one for one in found
        if one.drive_a in usable and one.drive_b in usable
        and one.submap_a < len(usable[one.drive_a]) and one.submap_b < len(usable[one.drive_b])
    ]  # fmt: skip
    met = {name for one in heard for name in (one.drive_a, one.drive_b)}
    return optimise_city([usable[name] for name in sorted(met)], heard, attempt.context.settings.city_graph)


def _places(drive_id: str, rows: Sequence[SubmapRow], frame: MapFrame) -> DrivePlaces:
    T_map_cell = wgs84.T_enu_enu(frame, MapFrame(*rows[0].frame))
    return DrivePlaces(
        drive_id,
        np.array([T_map_cell @ _own_T(row) for row in rows]),
        moved_covariance(T_map_cell, np.array([_own_covariance(row) for row in rows])),
        np.array([max(row.length_m, 1.0) for row in rows]),
        np.ones(len(rows) - 1, np.bool_),
    )


def _is_positive(covariance: FloatArray) -> bool:
    return bool((np.linalg.eigvalsh(covariance) > 0.0).all())


def _moved(attempt: StageAttempt, frame: MapFrame, rows: Sequence[SubmapRow], city: City, drive_id: str) -> Iterable[MovedSubmap]:
    """The submaps of a drive that lie elsewhere than their rows say, by the city graph or, without meetings, by the drive."""
    if not rows:
        return
    placed = city.drives.get(drive_id)
    T_cell_map = wgs84.T_enu_enu(MapFrame(*rows[0].frame), frame)
    for number, row in enumerate(rows):
        T, covariance = _own_T(row), _own_covariance(row)
        if placed is not None and placed.placed:
            T = rounded_place(T_cell_map @ placed.T_map_submap[number], T)
            covariance = rounded_covariance(moved_covariance(T_cell_map, placed.covariance[number][None])[0], T)
        if T.tolist() != row.T_enu_submap or covariance.tolist() != row.covariance:
            yield _moved_to(attempt, row, T, covariance)


def _moved_to(attempt: StageAttempt, row: SubmapRow, T: FloatArray, covariance: FloatArray) -> MovedSubmap:
    submap = decode_submap(attempt.context.blobs.get(row.digest), row.digest)
    placed = PlacedSubmap(submap, T, covariance, row.drive_id, MapFrame(*row.frame))
    track = wgs84.lonlatheight_from_enu(placed.track_enu(), MapFrame(*row.frame))[:, :2]
    points = wgs84.lonlatheight_from_enu(placed.points_enu(), MapFrame(*row.frame))[:, :2]
    own = row.own_T_enu_submap or row.T_enu_submap
    box = box_of(np.vstack([track, points]))
    return MovedSubmap(row.drive_id, row.position, row.digest, own, T.tolist(), covariance.tolist(), track.tolist(), box)


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


def _facts(city: City) -> dict[str, Any]:
    """What a reader of the version asks: how much drives that meet were moved, and what became of their meetings."""
    if not city.drives:
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
        }
    }
