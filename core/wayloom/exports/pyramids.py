"""Tile pyramids of a map that is exported: vector tiles, pictures of classes, rasters of the ground, all drawn region by region."""

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.exports.boxes import inside
from wayloom.exports.source import Feature, MapSource
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box, box_of, overlap, union_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.region_grid import RegionKey, region_box, regions_of_box
from wayloom.stitching.voxel_map import VoxelMap, joined_maps
from wayloom.tiles.cloud_pyramid import cloud_tiles
from wayloom.tiles.feature_layers import FEATURE_LAYERS
from wayloom.tiles.feature_tiles import feature_tiles
from wayloom.tiles.formats import Tile
from wayloom.tiles.grid import TILE_PX, TileAddress, pixel_from_lonlat, tile_bounds
from wayloom.tiles.ground_tiles import ground_tiles, tiles_of_region
from wayloom.tiles.mvt import LonLatTrack, tiles_of_track
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.updates import block_zoom, margin_px, updated_tiles

FloatArray = NDArray[np.float64]
DOT_M = 1.0
"""How far beyond its region a voxel is drawn, at most."""


class MapPyramid:
    """`updates.PyramidSource`, `feature_tiles.FeatureSource` and `ground_tiles.GroundSource` of a whole map, cut to a box.

    The map must have a place on Earth.
    """

    def __init__(self, source: MapSource, frame: MapFrame, box: Box | None, settings: TileSettings) -> None:
        self._source, self._frame, self._box, self._settings = source, frame, box, settings
        tracks = ((track.drive_id, track.points_enu) for track in source.tracks())
        lines = [LonLatTrack(name, wgs84.lonlatheight_from_enu(points, frame)[:, :2]) for name, points in tracks if len(points)]
        self._tracks = [track for track in lines if box is None or overlap(box_of(track.lon_lat), box)]

    def tiles(self) -> Iterator[Tile]:
        """Those of the static layer: pictures, vector tiles, points, counts."""
        return updated_tiles(self._blocks(), self, self._settings)

    def cloud_tiles(self) -> Iterator[Tile]:
        """The 3D tiles of the static layer, contents and tilesets."""
        return cloud_tiles(self._blocks(), self, self._settings)

    def feature_tiles(self) -> Iterator[Tile]:
        """Those of markings, areas and objects."""
        return feature_tiles(dict.fromkeys(FEATURE_LAYERS, self._source.keys), self, self._frame, self._settings)

    def ground_tiles(self) -> Iterator[Tile]:
        """Those of all raster layers of the ground."""
        return ground_tiles(self._source.keys, self, self._frame, self._settings)

    def bounds(self) -> Box:
        """West, south, east, north of the box, or of the regions."""
        return self._box or union_of([region_box(key, self._frame, 0.0) for key in self._source.keys])

    def _blocks(self) -> set[TileAddress]:
        """The blocks that may show anything."""
        zoom = block_zoom(self._settings)
        found = {address for key in self._source.keys for address in tiles_of_region(key, self._frame, zoom, DOT_M)}
        found.update(*(tiles_of_track(track, zoom) for track in self._tracks))
        return found if self._box is None else {one for one in found if overlap(tile_bounds(one), self._box)}

    def voxels(self, block: TileAddress) -> VoxelMap:
        """Those of the block and of its margin, region by region."""
        parts = [self._source.voxels(key) for key in sorted(regions_of_box(tile_bounds(block), self._frame))]
        found = joined_maps([part for part in parts if part is not None], self._frame, self._source.voxel_m)
        lon_lat = wgs84.lonlatheight_from_enu(found.points_enu, self._frame)[:, :2]
        pixels = pixel_from_lonlat(lon_lat, self._settings.max_zoom)
        edge = TILE_PX << (self._settings.max_zoom - block.z)
        low, margin = edge * np.array([block.x, block.y]), margin_px(self._settings)
        near = ((pixels >= low - margin) & (pixels < low + edge + margin)).all(axis=1)
        return found.take(near & inside(lon_lat, self._box))

    def stored(self, _name: str, _address: TileAddress) -> bytes | None:
        """Nothing was there before."""
        return None

    def tracks(self, _addresses: Collection[TileAddress]) -> Sequence[LonLatTrack]:
        """All of them."""
        return self._tracks

    def features(self, of: str, key: RegionKey) -> Sequence[Feature]:
        """Those of a layer in a region."""
        return self._source.features(of, key)

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of a region's ground."""
        return self._source.raster(key, name)

    def tile(self, _layer: str, _address: TileAddress) -> bytes | None:
        """Nothing was there before."""
        return None
