"""Update of a tile pyramid: the tiles that a change of some blocks can change, and no others.

A block is a tile of the zoom at which point tiles are cut. What is finer than a block is drawn from its own voxels; what is coarser
from the counts of the four tiles below it, which are kept as a layer of their own. So a change costs what it
touches and one way to the top, whatever else the map holds; and as a whole pyramid is an update of all of its blocks, a pyramid
that was updated is equal to one built at once, byte for byte.
"""

import itertools
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.stitching.layer_names import LAYERS, STATIC
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.cloud_pyramid import CloudUpdate, file_zoom, top_zoom
from wayloom.tiles.formats import Tile, tile_layer, tile_of
from wayloom.tiles.grid import TILE_PX, TileAddress, ancestor, children, pixel_from_lonlat, row_by_row
from wayloom.tiles.levels import Level, add_levels, coarser, decode_level, dilated, encode_level, finest_level, joined
from wayloom.tiles.mvt import BUFFER, EXTENT, LonLatTrack, encode_mvt, tiles_of_track
from wayloom.tiles.png import encode_png
from wayloom.tiles.points import PointTile, encode_points, origin_of, voxel_downsampled
from wayloom.tiles.settings import TileSettings

FloatArray = NDArray[np.float64]
GROUND = LAYERS[STATIC]
FINE_CELLS, COARSE_CELLS = 128, 64
VECTOR_STEPS = ((1, FINE_CELLS), (2, COARSE_CELLS))
"""How many zooms below a vector tile the pixels lie that are its cells: 128 = 256 / 2, 64 = 256 / 2^2."""


class PyramidSource(Protocol):
    """What an update reads of the map, as it is after the change."""

    def voxels(self, block: TileAddress) -> VoxelMap:
        """Those of a block, and those around it up to `MARGIN_PX` pixels of the finest zoom; always in the same order."""

    def stored(self, name: str, address: TileAddress) -> bytes | None:
        """The tile of a format (`TILE_FORMATS`) that was there before the change, for one that the change does not touch."""

    def tracks(self, addresses: Collection[TileAddress]) -> Sequence[LonLatTrack]:
        """At least those that come within `BUFFER` of one of the tiles, always in the same order; the addresses are of one zoom."""


@dataclass(frozen=True, slots=True)
class _Block:
    """A changed block: its tiles finer than itself, its point tiles, and its counts."""

    tiles: list[Tile]
    level: Level


def block_zoom(settings: TileSettings) -> int:
    """The zoom of the blocks."""
    return settings.block_zoom


def margin_px(settings: TileSettings) -> int:
    """How far around a block its pictures show voxels, in pixels of the finest zoom: a dot is three pixels wide."""
    return 1 << max(settings.max_zoom - settings.dot_from_zoom, 0)


def updated_tiles(
    changed: Collection[TileAddress], source: PyramidSource, settings: TileSettings, of: str = GROUND
) -> Iterator[Tile]:
    """Every tile that shows something in the scope of the changed blocks (`touched_tiles`), counts included.

    changed : blocks whose voxels, or tracks, may have changed
    of      : the layer of the map whose voxels the source gives: the static one, or an overlay
    A tile of the scope that does not come has nothing to show any more. Raises InputError beyond the latitudes of web mercator.
    """
    update = _Update(frozenset(changed), source, settings, of)
    for block in sorted(update.changed, key=row_by_row):
        made = update.block(block)
        update.levels[block] = made.level
        yield from made.tiles
    yield from update.coarse_tiles()
    if of == GROUND:
        yield from update.vector_tiles()


def touched_tiles(
    changed: Collection[TileAddress], settings: TileSettings, of: str = GROUND
) -> dict[tuple[str, int], frozenset[TileAddress]]:
    """The scope: for each layer of tiles and zoom, the tiles that a change of these blocks may change."""
    pictures = range(_coarsest(settings, of), settings.max_zoom + 1)
    found = {(tile_layer("png", of), z): frozenset(_touched(changed, z, 0.0)) for z in pictures}
    for z in range(_top(settings, of), block_zoom(settings) + 1):
        found[tile_layer("counts", of), z] = frozenset(_touched(changed, z, 0.0))
    found[tile_layer("points", of), settings.points_zoom] = frozenset(_touched(changed, settings.points_zoom, 0.0))
    for z in range(top_zoom(settings), settings.max_zoom + 1):
        found[tile_layer("glb", of), z] = frozenset(_touched(changed, z, 0.0))
        if file_zoom(z, settings) == z:
            found[tile_layer("tileset", of), z] = found[tile_layer("glb", of), z]
    if of == GROUND:
        for z in range(settings.min_zoom, settings.features_max_zoom + 1):
            found[tile_layer("mvt"), z] = frozenset(_touched(changed, z, BUFFER / EXTENT))
    return found


def _touched(changed: Iterable[TileAddress], zoom: int, margin: float) -> Iterator[TileAddress]:
    """The tiles of a zoom that a block touches, or comes near to within a margin given in tiles; may repeat."""
    seen: set[tuple[int, int, int, int]] = set()
    for block in changed:
        share = 2.0 ** (zoom - block.z)
        low_x, low_y = int(np.floor(block.x * share - margin)), int(np.floor(block.y * share - margin))
        high_x, high_y = int(np.ceil((block.x + 1) * share + margin)), int(np.ceil((block.y + 1) * share + margin))
        if (low_x, low_y, high_x, high_y) in seen:
            continue
        seen.add((low_x, low_y, high_x, high_y))
        world = 1 << zoom
        for y, x in itertools.product(range(max(low_y, 0), min(high_y, world)), range(low_x, high_x)):
            if 0 <= x < world:
                yield TileAddress(zoom, x, y)


def _coarsest(settings: TileSettings, of: str) -> int:
    """The coarsest zoom of a layer's pictures."""
    return settings.min_zoom if of == GROUND else max(settings.overlays_from_zoom, settings.min_zoom)


def _top(settings: TileSettings, of: str) -> int:
    """The coarsest zoom whose counts are kept: the vector tiles of the lowest zoom need the pixels one or two zooms below."""
    below = VECTOR_STEPS[-1][0] if of == GROUND else 0
    return max(min(_coarsest(settings, of) - below, block_zoom(settings)), 0)


class _Update:
    """One update: the changed blocks, and the levels that it has made so far."""

    def __init__(self, changed: frozenset[TileAddress], source: PyramidSource, settings: TileSettings, of: str) -> None:
        self.changed, self.source, self.settings, self.of = changed, source, settings, of
        self.levels: dict[TileAddress, Level] = {}
        self._cloud = CloudUpdate(changed, source, settings, of)
        self._read: dict[TileAddress, Level] = {}

    def block(self, block: TileAddress) -> _Block:
        """A block from its voxels."""
        voxels = self.source.voxels(block)
        assert voxels.frame is not None
        lon_lat_height = wgs84.lonlatheight_from_enu(voxels.points_enu, voxels.frame)
        wide = finest_level(lon_lat_height[:, :2], voxels.label, self.settings.max_zoom)
        tiles = list(self._point_tiles(block, voxels, lon_lat_height))
        tiles += self._cloud.block(block, voxels, lon_lat_height[:, :2])
        while wide.zoom > block.z:
            tiles += self._pictures(wide, block)
            wide = coarser(wide)
        level = joined(part for address, part in wide.tiles() if address == block) or Level.empty(block.z)
        return _Block(tiles, level)

    def _point_tiles(self, block: TileAddress, voxels: VoxelMap, lon_lat_height: FloatArray) -> Iterator[Tile]:
        zoom = self.settings.points_zoom
        places = pixel_from_lonlat(lon_lat_height[:, :2], zoom) // TILE_PX
        inside = np.flatnonzero((places >> (zoom - block.z) == (block.x, block.y)).all(axis=1))
        order = inside[np.lexsort((places[inside, 0], places[inside, 1]))]
        edges = np.flatnonzero((np.diff(places[order], axis=0) != 0).any(axis=1)) + 1
        for rows in np.split(order, edges) if len(order) else []:
            address = TileAddress(zoom, *places[rows[0]].tolist())
            points = point_tile(voxels.take(rows), lon_lat_height[rows], address)
            yield tile_of("points", address, encode_points(_thinned(points, self.settings, voxels.voxel_m)), self.of)

    def _pictures(self, level: Level, within: TileAddress) -> Iterator[Tile]:
        """The pictures of one zoom, those of a block or of one tile, of a level that may reach beyond."""
        if level.zoom < _coarsest(self.settings, self.of):
            return
        drawn = dilated(level) if level.zoom >= self.settings.dot_from_zoom else level
        for address, part in drawn.tiles():
            if ancestor(address, within.z) == within:
                yield tile_of("png", address, encode_png(part, self.settings.max_zoom), self.of)

    def coarse_tiles(self) -> Iterator[Tile]:
        """From the changed blocks to the top: pictures, and the counts that the next update reads."""
        top = _top(self.settings, self.of)
        for zoom in range(block_zoom(self.settings), top - 1, -1):
            here = sorted((address for address in self.levels if address.z == zoom), key=row_by_row)
            for address in here:
                level = self.levels[address]
                if len(level.cell):
                    yield tile_of("counts", address, encode_level(level), self.of)
                    yield from self._pictures(level, address)
            if zoom > top:
                for parent in {ancestor(address, zoom - 1) for address in here}:
                    below = [coarser(self._level(child)) for child in children(parent)]
                    self.levels[parent] = add_levels(zoom - 1, below)

    def _level(self, address: TileAddress) -> Level:
        """The counts of a tile as they are after the change."""
        if address in self.levels:
            return self.levels[address]
        if address not in self._read:
            stored = self.source.stored("counts", address)
            self._read[address] = Level.empty(address.z) if stored is None else decode_level(stored)
        return self._read[address]

    def vector_tiles(self) -> Iterator[Tile]:
        """The vector tiles of the scope, zoom by zoom from fine to coarse."""
        settings = self.settings
        for tile_zoom in range(settings.features_max_zoom, settings.min_zoom - 1, -1):
            cells = FINE_CELLS if tile_zoom >= settings.fine_cells_from_zoom else COARSE_CELLS
            of_cells = tile_zoom - next(step for step, count in VECTOR_STEPS if count == cells)
            wanted = frozenset(_touched(self.changed, tile_zoom, BUFFER / EXTENT))
            parts: dict[TileAddress, Level] = {}
            for home in sorted({ancestor(address, of_cells) for address in wanted}, key=row_by_row):
                for x, y, part in self._cells(home).blocks(cells):
                    parts[TileAddress(tile_zoom, x, y)] = part
            lines = self._lines(wanted) if tile_zoom >= settings.tracks_from_zoom else {}
            for address in sorted(wanted & (parts.keys() | lines.keys()), key=row_by_row):
                yield tile_of("mvt", address, encode_mvt(parts.get(address), cells, lines.get(address, [])))

    def _cells(self, home: TileAddress) -> Level:
        """The counts of a tile of any zoom; one that is finer than a block is made from the block's voxels."""
        zoom = block_zoom(self.settings)
        if home.z <= zoom:
            return self._level(home)
        voxels = self.source.voxels(ancestor(home, zoom))
        assert voxels.frame is not None
        places = wgs84.lonlatheight_from_enu(voxels.points_enu, voxels.frame)[:, :2]
        level = finest_level(places, voxels.label, self.settings.max_zoom)
        while level.zoom > home.z:
            level = coarser(level)
        return joined(part for address, part in level.tiles() if address == home) or Level.empty(home.z)

    def _lines(self, wanted: frozenset[TileAddress]) -> dict[TileAddress, list[tuple[str, list[tuple[int, int]]]]]:
        """For each wanted tile that a track crosses: (drive id, its piece of the line)."""
        lines: dict[TileAddress, list[tuple[str, list[tuple[int, int]]]]] = {}
        for track in self.source.tracks(wanted) if wanted else ():
            for address, pieces in tiles_of_track(track, next(iter(wanted)).z).items():
                if address in wanted:
                    lines.setdefault(address, []).extend((track.drive_id, piece) for piece in pieces)
        return lines


def point_tile(voxels: VoxelMap, lon_lat_height: FloatArray, address: TileAddress) -> PointTile:
    """The voxels of one tile in its own tangent plane, whose height is the whole metre in the middle of theirs."""
    heights = lon_lat_height[:, 2]
    origin = origin_of(address, float(np.round(0.5 * (heights.min() + heights.max()))))
    return PointTile(
        address,
        origin,
        wgs84.enu_from_lonlatheight(lon_lat_height, origin),
        np.ones(len(voxels), np.uint32),
        voxels.label,
        np.rint(255.0 * voxels.confidence).astype(np.uint8),
        np.minimum(voxels.drives, 255).astype(np.uint8),
    )


def _thinned(points: PointTile, settings: TileSettings, voxel_m: float) -> PointTile:
    return voxel_downsampled(points, settings.points_per_tile, voxel_m)
