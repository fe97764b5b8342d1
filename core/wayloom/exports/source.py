"""Map that is exported, as its writers see it: regions, ground, features and tracks, each read when it is asked for."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.ground_mosaic import RasterSource
from wayloom.stitching.region_grid import RegionKey
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.pyramid import Track

Feature = Mapping[str, Any]
"""A GeoJSON feature: WGS84, ellipsoidal heights."""


class MapSource(RasterSource, Protocol):
    """A map in one frame. No more than some regions of it are in memory at a time."""

    @property
    def frame(self) -> MapFrame | None:
        """Its frame; None: one drive's own, which has no place on Earth."""

    @property
    def voxel_m(self) -> float:
        """Edge of its voxels, m."""

    @property
    def keys(self) -> Sequence[RegionKey]:
        """Of the regions that have anything, sorted; of those that the wanted box touches alone."""

    @property
    def place(self) -> NDArray[np.float64]:
        """(3,) m in the frame: a place in the middle of the map, on its road."""

    def voxels(self, key: RegionKey) -> VoxelMap | None:
        """The static layer of a region; None where it has none."""

    def features(self, name: str, key: RegionKey) -> Sequence[Feature]:
        """The features of a collection (`features.COLLECTIONS`) that belong to a region."""

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """Of the sheets of a region's ground, as `GroundMap.place_sigma_mm`."""

    def tracks(self) -> Iterator[Track]:
        """The drives' tracks, in a fixed order."""

    def doubts(self) -> Mapping[str, Sequence[str]]:
        """What its drives warn of, by the drive's id; of those that warn of anything, and only as far as it is known."""

    def provenance(self) -> Mapping[str, Any]:
        """The map's origin: drives, hashes of what was uploaded, networks, code, parameters."""
