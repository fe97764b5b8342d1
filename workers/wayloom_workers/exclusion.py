"""Exclusion of areas from what the service has of drives: submaps, ground, sightings, places, looks, pictures and tracks.

What a stage left is rewritten file by file, each whole or not at all, and the rows at last: whoever is killed is followed by one
who finds the rest. The same submap and areas give the same bytes.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import structlog
from numpy.typing import NDArray

from wayloom.config.stages import drive_stages
from wayloom.dense.files import LOOKS_FILE, LookFile, save_looks
from wayloom.errors import InputError
from wayloom.exclusion.areas import Area
from wayloom.exclusion.clipping import (
    Inside,
    clipped_looks,
    clipped_places,
    clipped_sheet,
    clipped_sightings,
    clipped_submap,
    inside_of,
)
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.ground.files import SHEETS
from wayloom.objects.files import SIGHTINGS
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.drive_map import drive_map, write_image
from wayloom.pipeline.stages.submaps import PREVIEW_FILE
from wayloom.places.files import PLACES_FILE, load_places, save_places
from wayloom.store import excluded, gate, jobs, maps, runs
from wayloom.store.coming import facts_of, note
from wayloom.store.tables.drives import SubmapRow
from wayloom.store.withdrawal import forget_blobs
from wayloom.submaps.files import load_submaps, save_submaps
from wayloom.submaps.submap import PlacedSubmap, Submap, decode_submap
from wayloom_workers.stage_hooks import WorkerContext

log = structlog.get_logger()
SIGMAS: Final = 3.0
LEAST_MARGIN_M, MOST_MARGIN_M = 0.5, 20.0
"""Around an area: as far as the submap's place is uncertain, within these."""


@dataclass(frozen=True, slots=True)
class _Clipped:
    """A submap of a row: as it was, what lies in areas, as it is without that; the areas near it, and by how much they are wider
    for it."""

    row: SubmapRow
    before: Submap
    inside: Inside
    after: Submap
    areas: Mapping[str, Area]
    margin_m: float

    @property
    def token(self) -> str:
        """As it is written down of the row."""
        return _token([*self.areas], self.after.digest, self.row)

    def is_in(self) -> bool:
        """Whether it had points in an area itself, not only in what is added to it."""
        assert self.row.frame is not None
        T, frame = np.array(self.row.T_enu_submap, np.float64), MapFrame(*self.row.frame)
        return bool(inside_of([*self.areas.values()], T, frame, 0.0)(self.before.xyz.astype(np.float64)).any())

    def holds(self, lon_lat: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N,) whether places (N, 2) in degrees lie in the areas."""
        return np.asarray(np.any([area.contains(lon_lat, self.margin_m) for area in self.areas.values()], axis=0))


def exclude(context: WorkerContext, map_id: str) -> int:
    """Drop what lies in the map's excluded areas from all that the service has, drive by drive. Returns from how many submaps."""
    count = 0
    areas, of_drive = _near_areas(context, map_id)
    for drive_id, near in of_drive.items():
        items = [_clipped(context, row, {area_id: areas[area_id] for area_id in ids}) for row, ids in near]
        _rewrite(context, drive_id, items)
        log.info("areas excluded", drive_id=drive_id, submaps=len(items))
        count += len(items)
    return count


def _near_areas(context: WorkerContext, map_id: str) -> tuple[dict[str, Area], dict[str, list[tuple[SubmapRow, list[str]]]]]:
    """The map's areas, and for each drive those of its submaps that are not clipped with what is near them, and what that is."""
    rows: dict[tuple[str, int], SubmapRow] = {}
    near: dict[tuple[str, int], list[str]] = {}
    with context.database.read() as session:
        areas = {row.id: excluded.area_of(row) for row in excluded.of_map(session, map_id)}
        for area in excluded.of_map(session, map_id):
            for row in excluded.rows_near(session, area):
                rows[row.drive_id, row.position] = row
                near.setdefault((row.drive_id, row.position), []).append(area.id)
    of_drive: dict[str, list[tuple[SubmapRow, list[str]]]] = {}
    for name, row in sorted(rows.items()):
        ids = sorted(near[name])
        if row.clipped_with != _token(ids, row.digest, row):
            of_drive.setdefault(row.drive_id, []).append((row, ids))
    return areas, of_drive


def _token(areas: Sequence[str], digest: str, row: SubmapRow) -> str:
    return sha256_of_json([list(areas), digest, row.T_enu_submap, row.covariance])


def _clipped(context: WorkerContext, row: SubmapRow, areas: Mapping[str, Area]) -> _Clipped:
    T, covariance = np.array(row.T_enu_submap, np.float64), np.array(row.covariance, np.float64)
    sigma2 = np.linalg.eigvalsh(position_covariance(T[None], np.nan_to_num(covariance)[None])[0])[-1]
    margin_m = float(np.clip(SIGMAS * np.sqrt(max(sigma2, 0.0)), LEAST_MARGIN_M, MOST_MARGIN_M))
    assert row.frame is not None
    before = decode_submap(context.blobs.get(row.digest), row.digest)
    inside = inside_of([*areas.values()], T, MapFrame(*row.frame), margin_m)
    return _Clipped(row, before, inside, clipped_submap(before, inside), areas, margin_m)


def _rewrite(context: WorkerContext, drive_id: str, items: Sequence[_Clipped]) -> None:
    """The drive's files, then its rows."""
    with context.database.read() as session:
        keys = jobs.keys_of_outputs(session, drive_id, drive_stages())
    stages = {stage: context.folders.drive(drive_id) / "stages" / stage / key for stage, key in keys.items()}
    there = {stage: folder for stage, folder in stages.items() if folder.is_dir()}
    for item in items:
        context.blobs.put(item.after.encoded)
    picture = None
    if "submaps" in there:
        with _or_nothing(there["submaps"]):
            picture = _of_submaps(there, items)
    for stage, kind, clip in (("ground", SHEETS, clipped_sheet), ("objects", SIGHTINGS, clipped_sightings)):
        if stage in there:
            with _or_nothing(there[stage]):
                _of_each(kind, there[stage], items, clip)
    if "looks" in there:
        with _or_nothing(there["looks"]):
            _of_looks(there["looks"] / LOOKS_FILE, items)
    if "places" in there and "submaps" in there:
        with _or_nothing(there["places"]):
            _of_places(there["places"] / PLACES_FILE, load_submaps(there["submaps"]), items)
    preview = None if picture is None else context.blobs.put(picture)
    _write_rows(context, drive_id, items, preview)


@contextmanager
def _or_nothing(folder: Path) -> Iterator[None]:
    """What cannot be read cannot be clipped, and goes: the map does without it, as it would with what is damaged."""
    try:
        yield
    except InputError as error:
        log.warning("a stage's output cannot be clipped and is dropped", folder=folder.name, error=str(error))
        for file in folder.iterdir():
            file.unlink(missing_ok=True)


def _of_submaps(stages: Mapping[str, Path], items: Sequence[_Clipped]) -> bytes | None:
    """The folder of submaps, and the drive's picture from above, whose bytes are returned."""
    folder, after = stages["submaps"], {item.row.digest: item.after for item in items}
    placed = [replace(one, submap=after.get(one.submap.digest, one.submap)) for one in load_submaps(folder)]
    save_submaps(placed, folder)
    _drop_unlisted(folder, ".submap", {one.submap.digest for one in placed})
    if "georeference" not in stages:
        return None
    new = folder / f"new-{PREVIEW_FILE}"
    write_image(new, drive_map(load_georeference(stages["georeference"] / GEOREFERENCE_FILE), placed))
    os.replace(new, folder / PREVIEW_FILE)
    return (folder / PREVIEW_FILE).read_bytes()


def _of_each(kind: Any, folder: Path, items: Sequence[_Clipped], clip: Callable[[Any, Inside, str], Any]) -> None:
    """What a stage left of each submap; what was rewritten already bears the new name of its submap."""
    of_submap = {item.row.digest: item for item in items}
    found = []
    for submap, digest in kind.read_index(folder).items():
        one, item = kind.load(folder, digest), of_submap.get(submap)
        found.append(one if item is None else clip(one, item.inside, item.after.digest))
    kind.save(found, folder)
    _drop_unlisted(folder, kind.suffix, {one.digest for one in found})


def _drop_unlisted(folder: Path, suffix: str, listed: set[str]) -> None:
    for file in folder.glob(f"*{suffix}"):
        if file.name.removesuffix(suffix) not in listed:
            file.unlink(missing_ok=True)


def _of_looks(file: Path, items: Sequence[_Clipped]) -> None:
    frames = [item.before.keyframe_frame[item.inside(item.before.T_submap_cam[:, :3, 3])] for item in items]
    looks = LookFile(file).read()
    save_looks(clipped_looks(looks, np.concatenate(frames).astype(np.int64)), file)


def _of_places(file: Path, placed: Sequence[PlacedSubmap], items: Sequence[_Clipped]) -> None:
    """Rows of places count the drive's keyframes in the order of their frames."""
    places = load_places(file)
    row_of = {int(frame): row for row, frame in enumerate(np.sort(np.concatenate([p.submap.keyframe_frame for p in placed])))}
    if len(row_of) != len(places):
        raise InputError("counts other keyframes than the submaps", file=file, remedy="process the drive anew")
    keyframes, features, points = (np.zeros(len(one), bool) for one in (places, places.features, places.cloud))
    for item in items:
        keyframes[[row_of[int(frame)] for frame in item.before.keyframe_frame]] = item.inside(item.before.T_submap_cam[:, :3, 3])
        for k, frame in enumerate(item.before.keyframe_frame.tolist()):
            T, row = item.before.T_submap_cam[k], row_of[frame]
            for dropped, of, p_cam in (
                (features, places.features.keyframe, places.features.p_cam.astype(np.float64)),
                (points, places.cloud.keyframe, 0.01 * places.cloud.p_cam.astype(np.float64)),
            ):
                low, high = np.searchsorted(of, [row, row + 1])
                dropped[low:high] = item.inside(se3.transform(T, p_cam[low:high]))
    save_places(clipped_places(places, keyframes, features, points), file)


def _write_rows(context: WorkerContext, drive_id: str, items: Sequence[_Clipped], preview: str | None) -> None:
    """The rows of the submaps, the run that made them, the drive's picture and track; a submap that was placed or made anew
    meanwhile is left for the next look."""
    with context.database.write() as session:
        drive, renamed = gate.lock(session, drive_id), {}
        for item in items:
            row = session.get(SubmapRow, (drive_id, item.row.position), populate_existing=True)
            if row is None or (row.digest, row.T_enu_submap) != (item.row.digest, item.row.T_enu_submap):
                continue
            if item.after.digest != row.digest:
                renamed[row.digest] = item.after.digest
                if item.is_in():
                    excluded.show_no_more(session, drive_id, item.areas)
            row.digest, row.point_count, row.clipped_with = item.after.digest, len(item.after), item.token
            row.track = _outside(row.track, item)
            drive.track = drive.track and _outside(drive.track, item)
        run = runs.newest(session, drive_id)
        if run is not None:
            run.submaps = [renamed.get(digest, digest) for digest in run.submaps]
        forget_blobs(session, renamed, "objects")
        before = facts_of(drive).get("preview")
        if preview is not None and before not in (None, preview):
            forget_blobs(session, [before], "objects")
            note(drive, preview=preview)
        if renamed:
            maps.mark_changed(session, drive_id)


def _outside(track: Sequence[Sequence[float]], item: _Clipped) -> list[Any]:
    """The places of a track, longitude and latitude first, that lie in none of the areas."""
    if not track:
        return []
    lon_lat = np.array([place[:2] for place in track], np.float64)
    return [place for place, dropped in zip(track, item.holds(lon_lat), strict=True) if not dropped]
