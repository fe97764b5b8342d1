"""Markings and kerbs of some drives' sheets, merged as in the map, without a service."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.ground_map import GroundFile
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.merge import HALO_M, merge_sheets
from wayloom.ground.placed_sheet import PlacedSheet, reach
from wayloom.stitching.marking_files import read_features
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges, regions_within
from wayloom.stitching.region_markings import region_markings

HELD_RASTERS: Final = 48


def markings_of_sheets(
    placed: Sequence[PlacedSheet],
    frame: MapFrame,
    markings: MarkingSettings = MarkingSettings(),
    kerbs: KerbSettings = KerbSettings(),
) -> list[dict[str, Any]]:
    """The features of all regions, by column and row; the sheets are placed in `frame`, in any order."""
    ground = MergedGround(placed)
    made = ((key, region_markings(key, ground, frame, markings, kerbs)) for key in ground.keys)
    return [feature for key, data in made if data is not None for feature in read_features(data, str(key))]


class MergedGround:
    """The merged ground of sheets as `region_markings.GroundOfRegions`: packed, in memory.

    keys : of the regions that have ground, sorted
    """

    def __init__(self, placed: Sequence[PlacedSheet]) -> None:
        touched: set[RegionKey] = set()
        near: dict[RegionKey, list[PlacedSheet]] = {}
        for one in placed:
            box = reach(one.read(), one.T_map_submap)
            touched.update(regions_within(*box, around_m=0.0))
            for key in regions_within(*box, around_m=HALO_M):
                near.setdefault(key, []).append(one)
        made = ((key, merge_sheets(near[key], region_edges(key)[0], REGION_M)) for key in sorted(touched))
        self._files = {key: GroundFile(ground.encoded()) for key, ground in made if ground is not None}
        self._raster = lru_cache(HELD_RASTERS)(lambda key, name: self._files[key].raster(name))
        self.keys = [*self._files]

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of a region's ground."""
        return self._raster(key, name) if key in self._files else None

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """Of the sheets of a region's ground."""
        return self._files[key].place_sigma_mm
