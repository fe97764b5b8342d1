"""Stitch stage of the map: the regions that have changed are merged anew, and the tiles that show them cut anew.

What a version is made of depends on which drives are in the map and where they lie, never on which came first: a region is a
function of the submaps that bear on it, a tile of the regions and tracks that it shows.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import lru_cache
from typing import Any, Final

import numpy as np

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.pipeline.digests import sha256_of_json
from wayloom.stitching.regions import RegionKey, encode_region, fuse_region
from wayloom.store import map_versions, maps
from wayloom.store.map_versions import RegionEntry, TileEntry, TileKey
from wayloom.store.tables import SubmapRow
from wayloom.submaps.submap import PlacedSubmap, Submap, decode_submap
from wayloom.tiles.updates import touched_tiles, updated_tiles
from wayloom_workers.map_source import MapSource, blocks_of_box, region_box, regions_of_box
from wayloom_workers.map_state import MapState, read_state
from wayloom_workers.publishing import TILES_FILE
from wayloom_workers.stage_hooks import StageAttempt

FUSED_SHARE: Final = 0.6
"""Of the progress, when the regions are merged."""
HELD_SUBMAPS: Final = 64


def stitch(attempt: StageAttempt) -> None:
    """Merge the changed regions, store them and the tiles that show them as blobs, and list both in `tiles.json`."""
    with attempt.context.database.read() as session:
        state = read_state(session, str(attempt.claim.map_id), attempt.context.settings)
    regions, dropped_regions = _merged_regions(attempt, state)
    tiles, dropped_tiles = _cut_tiles(attempt, state, regions, dropped_regions)
    content: dict[str, Any] = {
        "base": state.base,
        "frame": [state.frame.lon_deg, state.frame.lat_deg, state.frame.height_m],
        "built_with": state.built_with,
        "drives": list(state.drives),
        "out_of_reach": list(state.out_of_reach),
        "submaps": len(state.submaps),
        "bounds": state.bounds,
        "taken_in": sorted(state.boxes),
        "tiles": [asdict(entry) for entry in tiles],
        "dropped_tiles": dropped_tiles,
        "regions": [asdict(entry) for entry in regions],
        "dropped_regions": dropped_regions,
    }
    (attempt.out_dir / TILES_FILE).write_text(json.dumps(content) + "\n", encoding="utf-8")


def _merged_regions(attempt: StageAttempt, state: MapState) -> tuple[list[RegionEntry], list[RegionKey]]:
    """The regions that are new or made from other submaps than before, and those that are no more."""
    keys = sorted({key for box in state.changed for key in regions_of_box(box, state.frame)})
    with attempt.context.database.read() as session:
        kept = map_versions.current_regions(session, str(attempt.claim.map_id), None if state.whole else keys)
    merger = _Merger(attempt, state)
    made: list[RegionEntry] = []
    gone: list[RegionKey] = sorted(kept.keys() - set(keys)) if state.whole else []
    for count, key in enumerate(keys):
        attempt.progress(FUSED_SHARE * count / len(keys), f"region {count + 1} of {len(keys)}")
        rows = merger.rows(key)
        inputs = merger.inputs(rows)
        if rows and key in kept and kept[key].inputs == inputs:
            continue
        entry = merger.region(key, rows, inputs) if rows else None
        if entry is not None:
            made.append(entry)
        elif key in kept:
            gone.append(key)
    return made, gone


class _Merger:
    """Merges regions, with the submaps that neighbours share decoded once."""

    def __init__(self, attempt: StageAttempt, state: MapState) -> None:
        self._context, self._map_id, self._state = attempt.context, str(attempt.claim.map_id), state
        self._submap = lru_cache(HELD_SUBMAPS)(self._decoded)
        self._T_map_cell = lru_cache(64)(lambda cell: wgs84.T_enu_enu(state.frame, MapFrame(*cell)))

    def rows(self, key: RegionKey) -> list[SubmapRow]:
        """The submaps that may bear on a region: whose boxes touch its own. Sorted."""
        with self._context.database.read() as session:
            rows = maps.submaps(session, self._map_id, region_box(key, self._state.frame))
        return [row for row in rows if (row.drive_id, row.position) in self._state.submaps]

    def inputs(self, rows: Sequence[SubmapRow]) -> str:
        """Digest of all that a region is made from."""
        places = [[row.drive_id, row.digest, row.frame, row.T_enu_submap, row.covariance] for row in rows]
        return sha256_of_json({"with": self._state.built_with, "submaps": places})

    def region(self, key: RegionKey, rows: Sequence[SubmapRow], inputs: str) -> RegionEntry | None:
        """The region, stored; one of a version that is kept, where it was made from the same; None when nothing lies in it."""
        with self._context.database.read() as session:
            again = map_versions.region_made_from(session, self._map_id, key, inputs)
        if again is not None and self._context.blobs.has(again.digest):
            return again
        voxels = fuse_region(key, self._placed(rows), self._context.settings.merge)
        if not len(voxels):
            return None
        data = encode_region(voxels)
        members = sorted([row.drive_id, row.digest] for row in rows)
        return RegionEntry(*key, inputs, self._context.blobs.put(data), members, len(data))

    def _placed(self, rows: Sequence[SubmapRow]) -> Iterator[PlacedSubmap]:
        """The submaps in the map's frame."""
        for row in rows:
            T_map_cell = self._T_map_cell(tuple(row.frame))
            covariance = moved_covariance(T_map_cell, np.array(row.covariance, np.float64)[None])[0]
            yield PlacedSubmap(self._submap(row.digest), self._T_map_submap(row), covariance, row.drive_id, self._state.frame)

    def _T_map_submap(self, row: SubmapRow) -> np.ndarray:
        moved: np.ndarray = self._T_map_cell(tuple(row.frame)) @ np.array(row.T_enu_submap, np.float64)
        return moved

    def _decoded(self, digest: str) -> Submap:
        return decode_submap(self._context.blobs.get(digest), digest)


def _cut_tiles(
    attempt: StageAttempt, state: MapState, regions: Sequence[RegionEntry], dropped: Sequence[RegionKey]
) -> tuple[list[TileEntry], list[TileKey]]:
    """The tiles that are new or other than before, and the addresses of those that have nothing to show any more."""
    settings = attempt.context.settings.tiles
    source = MapSource(attempt, state, {entry.key: entry.digest for entry in regions}, dropped)
    places = [*state.changed, *(region_box(key, state.frame) for key in [*(entry.key for entry in regions), *dropped])]
    changed = set().union(*(blocks_of_box(box, settings) for box in places))
    with attempt.context.database.read() as session:
        if state.whole:
            before = map_versions.all_current_tiles(session, str(attempt.claim.map_id))
        else:
            touched = touched_tiles(changed, settings)
            keys = [(layer, *address) for (layer, _), addresses in touched.items() for address in addresses]
            before = map_versions.current_tiles(session, str(attempt.claim.map_id), keys)
    shown: dict[TileKey, TileEntry] = {}
    for count, tile in enumerate(updated_tiles(changed, source, settings)):
        digest = attempt.context.blobs.put(tile.data)
        entry = TileEntry(tile.layer, tile.z, tile.x, tile.y, digest, tile.media_type, len(tile.data))
        shown[entry.key] = entry
        attempt.progress(FUSED_SHARE + (1.0 - FUSED_SHARE) * (1.0 - 0.5 ** (count / 200.0)), f"{count + 1} tiles")
    new = [entry for key, entry in sorted(shown.items()) if key not in before or before[key].digest != entry.digest]
    return new, sorted(before.keys() - shown.keys())
