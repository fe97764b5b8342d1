"""The map of a stitch as the source of its tiles: regions and counts by their blobs, tracks by the submaps' rows."""

import copy
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.layer_names import LAYERS, STATIC
from wayloom.stitching.region_files import decode_region
from wayloom.stitching.region_grid import RegionKey, regions_of_box
from wayloom.stitching.voxel_map import VoxelMap, joined_maps
from wayloom.store import maps
from wayloom.store.map_versions import current_regions
from wayloom.store.maps import Box
from wayloom.submaps.submap import decode_submap
from wayloom.tiles.formats import tile_layer
from wayloom.tiles.grid import TILE_PX, TileAddress, ancestor, pixel_from_lonlat, tile_bounds
from wayloom.tiles.mvt import BUFFER, EXTENT, LonLatTrack
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.updates import block_zoom, margin_px
from wayloom_workers.map_state import MapState, PlacedRow
from wayloom_workers.stage_hooks import StageAttempt

FloatArray = NDArray[np.float64]
HELD_REGIONS: Final = 32
TRACKS_TOGETHER: Final = 14
"""The zoom whose tiles are asked for their tracks in one query."""


class MapSource:
    """`wayloom.tiles.updates.PyramidSource` of one stitch: of the static layer, or, by `overlay`, of another.

    new      regions that this stitch has made, by the digest of their blobs; dropped: those that are no more
    """

    def __init__(
        self, attempt: StageAttempt, state: MapState, new: Mapping[RegionKey, str], dropped: Collection[RegionKey]
    ) -> None:
        self._context, self._map_id = attempt.context, str(attempt.claim.map_id)
        self._state, self._frame, self._base = state, state.frame, 0 if state.whole else state.base
        self._new, self._dropped = new, frozenset(dropped)
        self._settings = attempt.context.settings.tiles
        self._region = lru_cache(HELD_REGIONS)(self._decoded)
        self._of = LAYERS[STATIC]

    def overlay(self, name: str) -> "MapSource":
        """The same map's source of another layer."""
        found = copy.copy(self)
        found._of = name
        return found

    def is_in_new_regions(self) -> bool:
        """Whether a region that this stitch has made has anything of the layer."""
        return any(len(self._region(digest)[self._of]) for digest in self._new.values())

    def voxels(self, block: TileAddress) -> VoxelMap:
        """Those of the block and of its margin, region by region."""
        box = tile_bounds(block)
        keys = sorted(regions_of_box(box, self._frame))
        digests = self._digests(keys)
        found = joined_maps([self._region(digests[key])[self._of] for key in keys if key in digests], self._frame, self._voxel_m)
        pixels = pixel_from_lonlat(wgs84.lonlatheight_from_enu(found.points_enu, self._frame)[:, :2], self._settings.max_zoom)
        edge = TILE_PX << (self._settings.max_zoom - block.z)
        low, margin = edge * np.array([block.x, block.y]), margin_px(self._settings)
        inside = (pixels >= low - margin) & (pixels < low + edge + margin)
        return found.take(inside[:, 0] & inside[:, 1])

    def stored(self, name: str, address: TileAddress) -> bytes | None:
        """The tile of the version before."""
        if not self._base:
            return None
        with self._context.database.read() as session:
            row = maps.tile(session, self._map_id, self._base, tile_layer(name, self._of), *address)
        return None if row is None else self._context.blobs.get(row.digest)

    def tracks(self, addresses: Collection[TileAddress]) -> Sequence[LonLatTrack]:
        """The pieces of road of the submaps near these tiles, by drive and time."""
        found: dict[tuple[str, int, str], PlacedRow] = {}
        with self._context.database.read() as session:
            for box in _boxes(addresses):
                rows = self._state.rows(session, self._map_id, box)
                found |= {(row.drive_id, row.track_t_ns, row.digest): row for row in rows}
        return [LonLatTrack(key[0], self._track(found[key])) for key in sorted(found)]

    def _track(self, row: PlacedRow) -> FloatArray:
        """(K, 2) degrees; of a row that was written before rows had tracks, from its blob."""
        if row.track:
            return np.array(row.track, np.float64)
        submap = decode_submap(self._context.blobs.get(row.digest), row.digest)
        T = np.array(row.T_enu_submap, np.float64)
        places = submap.T_submap_cam[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
        return wgs84.lonlatheight_from_enu(places, MapFrame(*row.frame))[:, :2]

    @property
    def _voxel_m(self) -> float:
        return self._context.settings.merge.voxel_m

    def _digests(self, keys: Sequence[RegionKey]) -> dict[RegionKey, str]:
        with self._context.database.read() as session:
            held = {} if not self._base else current_regions(session, self._map_id, set(keys) - self._new.keys() - self._dropped)
        kept = {key: entry.digest for key, entry in held.items()}
        return kept | {key: self._new[key] for key in keys if key in self._new}

    def _decoded(self, digest: str) -> Mapping[str, VoxelMap]:
        """The layers of a region."""
        return decode_region(self._context.blobs.get(digest), digest).layers


def blocks_of_box(box: Box, settings: TileSettings) -> set[TileAddress]:
    """The blocks that show anything of a box of degrees."""
    west, south, east, north = box
    zoom = block_zoom(settings)
    edge, world = TILE_PX << (settings.max_zoom - zoom), 1 << zoom
    corners = pixel_from_lonlat(np.array([[west, north], [east - 360.0 if east > 180.0 else east, south]]), settings.max_zoom)
    margin = margin_px(settings)
    low, high = ((corners + np.array([[-margin], [margin]])) // edge).tolist()
    turns = world if high[0] < low[0] else 0
    columns = range(low[0], high[0] + turns + 1)
    return {TileAddress(zoom, x % world, y) for y in range(max(low[1], 0), min(high[1], world - 1) + 1) for x in columns}


def _boxes(addresses: Collection[TileAddress]) -> Iterator[Box]:
    """Boxes around all tiles that lie in one coarser tile, with the buffer around them."""
    groups: dict[TileAddress, list[TileAddress]] = {}
    for address in addresses:
        groups.setdefault(ancestor(address, min(address.z, TRACKS_TOGETHER)), []).append(address)
    for members in groups.values():
        bounds = np.array([tile_bounds(address) for address in members])
        low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        margin = BUFFER / EXTENT * (bounds[0, 2:] - bounds[0, :2]) * 1.01
        yield (*(low - margin).tolist(), *(high + margin).tolist())
