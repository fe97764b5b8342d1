"""Stitch stage of the map: all placed submaps merged in one frame and cut into tiles."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import rolled, union_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.stitching.grid import KEY_LIMITS
from wayloom.stitching.regions import RegionKey, fuse_region, regions_of, whole_map
from wayloom.store import maps
from wayloom.store.maps import TileEntry
from wayloom.store.tables import SubmapRow
from wayloom.submaps.submap import PlacedSubmap, decode_submap
from wayloom.tiles.pyramid import Track, build_tiles
from wayloom_workers.publishing import TILES_FILE
from wayloom_workers.stage_hooks import StageAttempt

SUBMAPS_KEPT: Final = 64
"""Unpacked, about 100 MB at full size. Regions come row by row, so their submaps do."""
MARGIN_M: Final = 500.0
"""Of the submaps' own size: they are judged by the place of their origin, and reach 100 m of road and 60 m of sight from it."""


def stitch(attempt: StageAttempt) -> None:
    """Merge every placed submap of the map, store the tiles as blobs and list them in `tiles.json`."""
    with attempt.context.database.read() as session:
        placed = maps.submaps(session, str(attempt.claim.map_id))
    frame, rows = _within_reach(attempt, placed)
    drives = sorted({row.drive_id for row in rows})
    content: dict[str, Any] = {
        "frame": [frame.lon_deg, frame.lat_deg, frame.height_m],
        "drives": drives,
        "out_of_reach": sorted({row.drive_id for row in placed}.difference(drives)),
        "submaps": len(rows),
        "bounds": _bounds(rows),
        "tiles": [asdict(entry) for entry in _tiles(attempt, rows, frame)] if rows else [],
    }
    (attempt.out_dir / TILES_FILE).write_text(json.dumps(content) + "\n", encoding="utf-8")


def _within_reach(attempt: StageAttempt, rows: Sequence[SubmapRow]) -> tuple[MapFrame, Sequence[SubmapRow]]:
    """The frame of the map and the submaps that its grid can hold: one drive of another city must not stop the map.

    The frame is the settings' origin, or, of the cells that the drives lie in, the most south-western of those that reach the most
    submaps. So it depends on which drives are in the map, never on which came first. A drive of a neighbouring cell is moved over
    exactly: both frames are rigid.
    """
    settings = attempt.context.settings
    origin, reach_m = settings.map_origin, KEY_LIMITS * settings.merge.voxel_m - MARGIN_M
    cells = {tuple(row.frame) for row in rows} if origin is None else {origin}
    reached = [(MapFrame(*cell), _reached(MapFrame(*cell), rows, reach_m)) for cell in sorted(cells)]
    return max(reached, key=lambda item: len(item[1]), default=(MapFrame(0.0, 0.0, 0.0), []))


def _reached(frame: MapFrame, rows: Sequence[SubmapRow], reach_m: NDArray[np.float64]) -> list[SubmapRow]:
    """The submaps, each by the place of its origin, that lie within reach_m (3,) of the frame's origin along every axis."""
    if not rows:
        return []
    places = [(wgs84.T_enu_enu(frame, MapFrame(*row.frame)) @ np.array(row.T_enu_submap, np.float64))[:3, 3] for row in rows]
    near = np.flatnonzero((np.abs(np.array(places)) < reach_m).all(axis=1))
    return [rows[i] for i in near.tolist()]


def _tiles(attempt: StageAttempt, rows: Sequence[SubmapRow], frame: MapFrame) -> list[TileEntry]:
    """Fuse region by region, cut, and store each tile under its hash."""
    settings = attempt.context.settings
    load = lru_cache(maxsize=SUBMAPS_KEPT)(lambda row: _placed(attempt, rows[row], frame))
    tracks, rows_of = _reach(attempt, load, len(rows))
    regions = []
    for count, key in enumerate(sorted(rows_of)):
        attempt.progress(0.1 + 0.4 * count / len(rows_of), f"region {count + 1} of {len(rows_of)}")
        regions.append(fuse_region(key, [load(row) for row in rows_of[key]], settings.merge))
    voxels = whole_map(regions, frame, settings.merge)
    entries = []
    for count, tile in enumerate(build_tiles(voxels, frame, settings.tiles, tracks)):
        digest = attempt.context.blobs.put(tile.data)
        entries.append(TileEntry(tile.layer, tile.z, tile.x, tile.y, digest, tile.media_type, len(tile.data)))
        attempt.progress(0.5 + 0.5 * (1.0 - 0.5 ** (count / 200.0)), f"{count + 1} tiles")
    return entries


def _reach(
    attempt: StageAttempt, load: Callable[[int], PlacedSubmap], count: int
) -> tuple[list[Track], dict[RegionKey, list[int]]]:
    """The tracks of all submaps, in an order of their own, and the submaps, by row, that reach each region."""
    tracks: list[tuple[tuple[str, int, str], Track]] = []
    rows_of: dict[RegionKey, list[int]] = {}
    for row in range(count):
        attempt.progress(0.1 * row / count, f"submap {row + 1} of {count}")
        item = load(row)
        if len(item.submap.keyframe_t_ns):
            name = (item.drive_id, int(item.submap.keyframe_t_ns[0]), item.submap.digest)
            tracks.append((name, Track(item.drive_id, item.track_enu())))
        for key in regions_of(item, attempt.context.settings.merge):
            rows_of.setdefault(key, []).append(row)
    return [track for _, track in sorted(tracks, key=lambda entry: entry[0])], rows_of


def _placed(attempt: StageAttempt, row: SubmapRow, frame: MapFrame) -> PlacedSubmap:
    """A submap in the map's frame."""
    submap = decode_submap(attempt.context.blobs.get(row.digest), row.digest)
    T_map_row = wgs84.T_enu_enu(frame, MapFrame(*row.frame))
    covariance = moved_covariance(T_map_row, np.array(row.covariance, np.float64)[None])[0]
    return PlacedSubmap(submap, T_map_row @ np.array(row.T_enu_submap, np.float64), covariance, row.drive_id, frame)


def _bounds(rows: Sequence[SubmapRow]) -> maps.Box | None:
    """The box around all submaps, degrees; as in GeoJSON, across the antimeridian west is the greater."""
    if not rows:
        return None
    west, south, east, north = union_of([(row.min_lon, row.min_lat, row.max_lon, row.max_lat) for row in rows])
    return west, south, rolled(east), north
