"""The ground of a stitch as the source of its raster tiles: regions and tiles by their blobs."""

from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.ground_map import GroundFile
from wayloom.stitching.region_grid import RegionKey
from wayloom.store import maps
from wayloom.store.map_versions import RegionEntry
from wayloom.tiles.grid import TileAddress
from wayloom_workers.map_state import MapState
from wayloom_workers.region_entries import RegionEntries
from wayloom_workers.stage_hooks import StageAttempt

HELD_FILES: Final = 32
HELD_RASTERS: Final = 48
"""Of up to five megabytes."""


class GroundOfMap:
    """`wayloom.tiles.ground_tiles.GroundSource` and `wayloom.stitching.ground_mosaic.GroundOfRegions` of one stitch.

    made     regions that this stitch has made; dropped: those that are no more
    """

    def __init__(
        self, attempt: StageAttempt, state: MapState, made: Mapping[RegionKey, RegionEntry], dropped: Collection[RegionKey]
    ) -> None:
        self._context, self._map_id = attempt.context, str(attempt.claim.map_id)
        self._base = 0 if state.whole else state.base
        self._entries = RegionEntries(attempt, state, made, dropped)
        self._file = lru_cache(HELD_FILES)(lambda digest: GroundFile(self._context.blobs.get(digest), digest))
        self._raster = lru_cache(HELD_RASTERS)(lambda digest, name: self._file(digest).raster(name))

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of a region's ground."""
        digest = self._digest(key)
        return self._raster(digest, name) if digest else None

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """Of the sheets of a region's ground."""
        return self._file(self._digest(key)).place_sigma_mm

    def tile(self, layer: str, address: TileAddress) -> bytes | None:
        """The tile of the version before."""
        if not self._base:
            return None
        with self._context.database.read() as session:
            row = maps.tile(session, self._map_id, self._base, layer, *address)
        return None if row is None else self._context.blobs.get(row.digest)

    def _digest(self, key: RegionKey) -> str:
        entry = self._entries.at(key)
        return "" if entry is None else entry.ground
