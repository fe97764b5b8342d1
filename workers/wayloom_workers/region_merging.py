"""Merge of the changed regions of a map, by one worker or, in parts, by several."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.files.atomic import write_atomically
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import overlap
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.ground.merge import merge_sheets
from wayloom.pipeline.digests import sha256_of_json
from wayloom.stitching.admission import Verdict
from wayloom.stitching.region_files import encode_region
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_box, region_edges, regions_of_box
from wayloom.stitching.region_objects import region_objects
from wayloom.stitching.regions import fuse_region
from wayloom.stitching.settings import HALO_M, LOOK_HALO_M
from wayloom.store import map_versions, maps
from wayloom.store.map_versions import MovedSubmap, RegionEntry
from wayloom.submaps.submap import PlacedSubmap, Submap, decode_submap
from wayloom_workers.change_evidence import DriveLooks, change_features
from wayloom_workers.city_alignment import Alignment, align
from wayloom_workers.drive_sheets import DriveSheets
from wayloom_workers.drive_sightings import DriveSightings
from wayloom_workers.map_state import MapState, PlacedRow, read_state
from wayloom_workers.stage_hooks import StageAttempt, StageParts

HELD_SUBMAPS: Final = 64
REGIONS_OF_PART: Final = 32
"""Neighbours, so that a part decodes few submaps of another's; fewer changed regions than two parts' are merged by one worker."""
PLAN_FILE, PLACES_FILE, PART_FILE = "plan.json", "places.json", "regions.json"


def aligned_state(attempt: StageAttempt) -> MapState:
    """The state of the map with its drives aligned."""
    map_id = str(attempt.claim.map_id)
    with attempt.context.database.read() as session:
        state = read_state(session, map_id, attempt.context.settings)
        changed = maps.candidates(session, map_id) if state.whole else map_versions.changed_drives(session, map_id)
    return state.aligned(align(attempt, state.frame, changed, state.candidates))


def changed_regions(state: MapState) -> list[RegionKey]:
    """The regions that are to be looked through, sorted: columns of neighbours."""
    return sorted({key for box in state.changed for key in regions_of_box(box, state.frame, LOOK_HALO_M)})


class Merger:
    """Merges regions, their voxels, ground and objects, with what neighbours share decoded once."""

    def __init__(self, attempt: StageAttempt, state: MapState) -> None:
        self._context, self._map_id, self._state = attempt.context, str(attempt.claim.map_id), state
        self._submap, self._looks = lru_cache(HELD_SUBMAPS)(self._decoded), DriveLooks(attempt.context)
        self._sheets, self._sightings = DriveSheets(attempt.context), DriveSightings(attempt.context)
        self._T_map_cell = lru_cache(64)(lambda cell: wgs84.T_enu_enu(state.frame, MapFrame(*cell)))

    def rows(self, key: RegionKey) -> list[PlacedRow]:
        """The submaps that may bear on a region, by points, looks, ground or sightings: whose boxes touch its own. Sorted."""
        near, far = (region_box(key, self._state.frame, halo_m) for halo_m in (HALO_M, LOOK_HALO_M))
        with self._context.database.read() as session:
            rows = self._state.rows(session, self._map_id, far)
        return [row for row in rows if overlap(row.box, near) or self._bears_far(row)]

    def _bears_far(self, row: PlacedRow) -> bool:
        far = (self._sheets, self._sightings)
        return self._looks.key(row.drive_id) is not None or any(one.digest(row.drive_id, row.digest) is not None for one in far)

    def inputs(self, rows: Sequence[PlacedRow]) -> str:
        """Digest of all that a region is made from."""
        places = [[row.drive_id, row.digest, row.frame, row.T_enu_submap, row.covariance] for row in rows]
        looks = {row.drive_id: self._looks.key(row.drive_id) for row in rows}
        found = {
            name: [one.digest(row.drive_id, row.digest) for row in rows]
            for name, one in (("sheets", self._sheets), ("sightings", self._sightings))
        }
        return sha256_of_json({"with": self._state.built_with, "submaps": places, "looks": looks, **found})

    def region(self, key: RegionKey, rows: Sequence[PlacedRow], inputs: str) -> RegionEntry | None:
        """The region, stored; one of a version that is kept, where it was made from the same; None when nothing lies in it."""
        with self._context.database.read() as session:
            again = map_versions.region_made_from(session, self._map_id, key, inputs)
        if again is not None and all(map(self._context.blobs.has, filter(None, (again.digest, again.ground, again.objects)))):
            return again
        placed = list(self._placed(rows))
        region = fuse_region(key, placed, self._context.settings.merge, looks=self._looks.placed(placed))
        ground = merge_sheets(self._sheets.placed(placed), region_edges(key)[0], REGION_M)
        sighted = self._sightings.placed(placed)
        objects = region_objects(key, sighted, self._state.frame, self._context.settings.object_fusion) if sighted else None
        if not any(map(len, region.layers.values())) and not region.changes and ground is None and objects is None:
            return None
        data = encode_region(region, self._state.frame)
        members = sorted([row.drive_id, row.digest] for row in rows)
        changes = change_features(region.changes, self._state.frame)
        of_ground = "" if ground is None else self._context.blobs.put(ground.encoded())
        of_objects = "" if objects is None else self._context.blobs.put(objects)
        digest = self._context.blobs.put(data)
        return RegionEntry(*key, inputs, digest, members, len(data), changes, of_ground, objects=of_objects)

    def _placed(self, rows: Sequence[PlacedRow]) -> Iterator[PlacedSubmap]:
        """The submaps in the map's frame."""
        for row in rows:
            T_map_cell = self._T_map_cell(tuple(row.frame))
            covariance = moved_covariance(T_map_cell, np.array(row.covariance, np.float64)[None])[0]
            yield PlacedSubmap(self._submap(row.digest), self._T_map_submap(row), covariance, row.drive_id, self._state.frame)

    def _T_map_submap(self, row: PlacedRow) -> np.ndarray:
        moved: np.ndarray = self._T_map_cell(tuple(row.frame)) @ np.array(row.T_enu_submap, np.float64)
        return moved

    def _decoded(self, digest: str) -> Submap:
        return decode_submap(self._context.blobs.get(digest), digest)


def _placement(state: MapState) -> dict[str, Any]:
    """What the alignment has found, JSON-ready."""
    verdicts = {name: asdict(one) for name, one in state.verdicts.items()}
    return {"moved": [asdict(one) for one in state.moved.values()], "verdicts": verdicts}


class RegionParts:
    """The regions of a stitch in parts. What a part leaves is named by what it was made from, so it may be older than the stitch
    that reads it."""

    def __init__(self, attempt: StageAttempt, folder: Path) -> None:
        self._attempt, self._folder = attempt, folder

    def of_stage(self) -> StageParts:
        """How workers make them."""
        return StageParts(self._folder, self._missing, self._has, self._make, lambda part: self._folder / str(part))

    def made(self) -> dict[RegionKey, RegionEntry]:
        """What finished parts have left."""
        lists = (json.loads(path.read_text(encoding="utf-8")) for path in sorted(self._folder.glob(f"*/{PART_FILE}")))
        entries = (RegionEntry(**entry) for found in lists for entry in found)
        return {entry.key: entry for entry in entries}

    def _state(self) -> MapState:
        """The state that the plan was made for; without one, as it is."""
        places = self._folder / PLACES_FILE
        if not places.is_file():
            return aligned_state(self._attempt)
        with self._attempt.context.database.read() as session:
            state = read_state(session, str(self._attempt.claim.map_id), self._attempt.context.settings)
        found = json.loads(places.read_text(encoding="utf-8"))
        verdicts = {name: Verdict(**{**one, "drives": tuple(one["drives"])}) for name, one in found["verdicts"].items()}
        return state.aligned(Alignment(tuple(MovedSubmap.from_json(one) for one in found["moved"]), {}, verdicts))

    def _missing(self) -> list[int]:
        """The parts of the plan, written down at the first look, that are not there."""
        plan = self._folder / PLAN_FILE
        if not plan.is_file():
            state = self._state()
            keys = changed_regions(state)
            parts = [keys[start : start + REGIONS_OF_PART] for start in range(0, len(keys), REGIONS_OF_PART)]
            if len(parts) < 2:
                return []
            self._folder.mkdir(parents=True, exist_ok=True)
            write_atomically(self._folder / PLACES_FILE, json.dumps(_placement(state)).encode())
            write_atomically(plan, json.dumps(parts).encode())
        return [number for number, _ in enumerate(self._plan(), 1) if not self._has(number)]

    def _plan(self) -> list[list[RegionKey]]:
        found = json.loads((self._folder / PLAN_FILE).read_text(encoding="utf-8"))
        return [[(east, north) for east, north in part] for part in found]

    def _has(self, part: int) -> bool:
        return (self._folder / str(part) / PART_FILE).is_file()

    def _make(self, part: int) -> None:
        merger, keys = Merger(self._attempt, self._state()), self._plan()[part - 1]
        found = []
        for count, key in enumerate(keys):
            self._attempt.progress(count / len(keys), f"region {count + 1} of {len(keys)}")
            rows = merger.rows(key)
            entry = merger.region(key, rows, merger.inputs(rows)) if rows else None
            if entry is not None:
                found.append(asdict(entry))
        write_atomically(self._attempt.out_dir / PART_FILE, json.dumps(found).encode())
