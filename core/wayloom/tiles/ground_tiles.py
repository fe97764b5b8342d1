"""Update of the raster pyramids of the ground: the tiles that changed regions can change, and no others.

The finest tiles are drawn from the regions, each coarser one from the bytes of the four below it, those that have not changed as
they are stored. So a pyramid that was updated is equal to one built at once, byte for byte.
"""

from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import closing
from functools import cache
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE, VOID
from wayloom.config.side_by_side import in_order
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.ground.kernels import rendering
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES, PIXEL_M
from wayloom.stitching.ground_mosaic import RasterSource, mosaic
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_box, region_edges, regions_of_box
from wayloom.tiles.formats import Tile
from wayloom.tiles.grid import TileAddress, children, lonlat_from_unit, row_by_row, tile_bounds, unit_from_lonlat
from wayloom.tiles.rasters import CLEAR, HEIGHT, ORTHO, RASTER_LAYERS, RASTER_PX, Picture, decode_picture, heights_picture
from wayloom.tiles.settings import TileSettings

FloatArray = NDArray[np.float64]
NODES: Final = 17
"""Of a tile along each edge, at which its place in the map is computed; between them it is interpolated."""
EDGE_M: Final = 0.2
"""What a pixel shows may come from so far beside it."""
COLOURS: Final = np.zeros((256, 4), np.uint8)
COLOURS[list(GROUND_CLASSES), :3] = PALETTE[list(GROUND_CLASSES)]
COLOURS[list(GROUND_CLASSES), 3] = 255
Scope = dict[tuple[str, int], frozenset[TileAddress]]
"""For each layer and zoom, tiles."""
BLOCK_ZOOMS: Final = 2
"""A thread makes a tile and all below it in so many zooms, 21 at most: enough to be worth a thread, few enough to be held."""
HeightOfRegion = Callable[[RegionKey], float | None]
"""m above the ellipsoid; None without ground."""
MadeTiles = Callable[[TileAddress], Generator[Tile, None, bytes | None]]
"""Tiles in one, and that one's own bytes."""


class GroundSource(RasterSource, Protocol):
    """What an update reads of the map's ground, as it is after the change."""

    def tile(self, layer: str, address: TileAddress) -> bytes | None:
        """The tile that was there before the change, for one that the change does not touch."""


def finest_zoom(layer: str, settings: TileSettings) -> int:
    """The finest zoom of a raster layer."""
    return settings.ortho_zoom - RASTER_LAYERS[layer].coarser_by


def coarsest_zoom(layer: str, settings: TileSettings) -> int:
    """Its coarsest."""
    return min(settings.min_zoom, finest_zoom(layer, settings))


def touched_rasters(changed: Collection[RegionKey], frame: MapFrame, settings: TileSettings) -> Scope:
    """The scope: the raster tiles that a change of the ground of these regions may change."""
    finest = {address for key in changed for address in tiles_of_region(key, frame, settings.ortho_zoom, EDGE_M)}
    scope: Scope = {}
    for zoom in range(settings.ortho_zoom, min(coarsest_zoom(layer, settings) for layer in RASTER_LAYERS) - 1, -1):
        for layer in RASTER_LAYERS:
            if coarsest_zoom(layer, settings) <= zoom <= finest_zoom(layer, settings):
                scope[layer, zoom] = frozenset(finest)
        finest = {TileAddress(zoom - 1, one.x >> 1, one.y >> 1) for one in finest}
    return scope


def ground_tiles(
    changed: Collection[RegionKey], source: GroundSource, frame: MapFrame, settings: TileSettings, threads: int = 1
) -> Iterator[Tile]:
    """Every tile of the scope that shows something; one that does not come has nothing to show any more.

    threads : share the blocks of a tile and what lies below it; what comes, and in which order, does not depend on it
    """
    scope, height_m = touched_rasters(changed, frame, settings), region_heights(source, frame)
    for layer in RASTER_LAYERS:
        update = _Update(layer, scope, source, frame, settings, height_m)
        yield from update.all_made(threads)


class _Update:
    """One update of one layer, depth first: of each zoom four tiles are held at a time, and the blocks that threads are ahead."""

    def __init__(
        self, layer: str, scope: Scope, source: GroundSource, frame: MapFrame, settings: TileSettings, height_m: HeightOfRegion
    ) -> None:
        self._layer, self._scope, self._source, self._frame = RASTER_LAYERS[layer], scope, source, frame
        self._finest, self._coarsest, self._height_m = finest_zoom(layer, settings), coarsest_zoom(layer, settings), height_m
        self._zoom_of_blocks = max(self._coarsest, self._finest - BLOCK_ZOOMS)

    def all_made(self, threads: int) -> Iterator[Tile]:
        """The tiles of the scope: blocks by threads, what is coarser from them."""
        top = sorted(self._scope[self._layer.name, self._coarsest], key=row_by_row)
        with closing(in_order(self._block, (one for address in top for one in self._blocks_in(address)), threads)) as blocks:

            def made(address: TileAddress) -> Generator[Tile, None, bytes | None]:
                if address.z < self._zoom_of_blocks or address not in self._scope[self._layer.name, address.z]:
                    return (yield from self._made(address, made))
                tiles, data = next(blocks)
                yield from tiles
                return data

            for address in top:
                yield from made(address)

    def _blocks_in(self, address: TileAddress) -> Iterator[TileAddress]:
        """The blocks of the scope in a tile, in the order in which they are asked for."""
        if address.z < self._zoom_of_blocks:
            for child in children(address):
                yield from self._blocks_in(child)
        elif address in self._scope[self._layer.name, address.z]:
            yield address

    def _block(self, address: TileAddress) -> tuple[list[Tile], bytes | None]:
        """The tiles of the scope in a block, and the block's own bytes."""
        tiles: list[Tile] = []

        def made(one: TileAddress) -> Generator[Tile, None, bytes | None]:
            return (yield from self._made(one, made))

        walk = made(address)
        while True:
            try:
                tiles.append(next(walk))
            except StopIteration as end:
                return tiles, end.value

    def _made(self, address: TileAddress, finer: MadeTiles) -> Generator[Tile, None, bytes | None]:
        """The tiles of the scope in this one; returns its own bytes, None where it shows nothing. finer : makes those below it."""
        if address not in self._scope[self._layer.name, address.z]:
            return self._source.tile(self._layer.name, address)
        if address.z == self._finest:
            picture = drawn(self._layer.name, address, self._source, self._frame, self._height_m)
        else:
            picture = yield from self._coarser(address, finer)
        if picture is None or not picture[..., 3].any():
            return None
        data = self._layer.codec.encode(picture)
        yield Tile(self._layer.name, *address, self._layer.media_type, data)
        return data

    def _coarser(self, address: TileAddress, finer: MadeTiles) -> Generator[Tile, None, Picture | None]:
        half, picture = RASTER_PX // 2, CLEAR.copy()
        for child in children(address):
            data = yield from finer(child)
            if data is not None:
                row, column = half * (child.y & 1), half * (child.x & 1)
                part = self._layer.codec.coarser(decode_picture(data, f"{self._layer.name} {child}"))
                picture[row : row + half, column : column + half] = part
        return picture


def drawn(layer: str, address: TileAddress, source: GroundSource, frame: MapFrame, height_m: HeightOfRegion) -> Picture | None:
    """The picture of a tile from the regions that it shows; None where they have no ground.

    Each pixel shows the ground at its middle, at the height of the ground around: far from the frame's origin the frame leans.
    """
    keys = [
        key for key in sorted(regions_of_box(tile_bounds(address), frame, EDGE_M)) if source.raster(key, "height_mm") is not None
    ]
    if not keys:
        return None
    heights = [one for one in map(height_m, keys) if one is not None]
    nodes = _nodes_enu(address, frame, float(np.median(heights)) if heights else frame.height_m)
    x, y = (_between(nodes[..., axis]) for axis in range(2))
    unit_m, names = (
        (PIXEL_M, ("colour", "sharpness")) if layer == ORTHO else (CELL_M, ("height_mm",) if layer == HEIGHT else ("votes",))
    )
    low = np.floor(np.array([x.min(), y.min()]) / unit_m).astype(np.int64) - 1
    high = np.ceil(np.array([x.max(), y.max()]) / unit_m).astype(np.int64) + 2
    rasters = [mosaic(keys, source, name, low, high, unit_m) for name in names]
    column, row = x / unit_m - low[0] - 0.5, y / unit_m - low[1] - 0.5
    picture = CLEAR.copy()
    if layer == ORTHO:
        rendering.draw_colour(rasters[0], rasters[1] > 0, column, row, picture)
    elif layer == HEIGHT:
        height = np.empty((RASTER_PX, RASTER_PX))
        rendering.draw_height(rasters[0], NO_HEIGHT, column, row, height)
        picture = heights_picture(height + _between(_ellipsoidal(nodes, frame)))
    else:
        best = np.asarray(GROUND_CLASSES, np.uint8)[np.argmax(rasters[0], axis=2)]
        label = np.full((RASTER_PX, RASTER_PX), VOID, np.uint8)
        rendering.draw_nearest(np.where(rasters[0].any(axis=2), best, VOID).astype(np.uint8), VOID, column, row, label)
        picture = COLOURS[label]
    return picture


def tiles_of_region(key: RegionKey, frame: MapFrame, zoom: int, around_m: float) -> Iterator[TileAddress]:
    """The tiles that a region and so much around it touch, and perhaps some beside them."""
    west, south, east, north = region_box(key, frame, around_m)
    corners = unit_from_lonlat(np.array([[west, north], [east - 360.0 if east > 180.0 else east, south]]))
    world = 1 << zoom
    (left, top), (right, bottom) = np.floor(corners * world).astype(int).tolist()
    right += world if right < left else 0
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            yield TileAddress(zoom, x % world, y)


def region_heights(source: RasterSource, frame: MapFrame) -> HeightOfRegion:
    """The median height of a region's ground, m above the ellipsoid, found once; None where it has none."""

    @cache
    def height_m(key: RegionKey) -> float | None:
        height_mm = source.raster(key, "height_mm")
        known = height_mm[height_mm != NO_HEIGHT] if height_mm is not None else np.zeros(0)
        if not len(known):
            return None
        place = np.array([[*(region_edges(key)[0] + REGION_M / 2.0), float(np.median(known)) / 1000.0]])
        return float(wgs84.lonlatheight_from_enu(place, frame)[0, 2])

    return height_m


def _nodes_enu(address: TileAddress, frame: MapFrame, height_m: float) -> FloatArray:
    """(NODES, NODES, 3): rows from the north."""
    share = np.linspace(0.0, 1.0, NODES)
    column, row = np.meshgrid(address.x + share, address.y + share)
    lon_lat = lonlat_from_unit(np.column_stack([column.ravel(), row.ravel()]) / (1 << address.z))
    places = np.column_stack([lon_lat, np.full(len(lon_lat), height_m)])
    return wgs84.enu_from_lonlatheight(places, frame).reshape(NODES, NODES, 3)


def _ellipsoidal(nodes: FloatArray, frame: MapFrame) -> FloatArray:
    """(NODES, NODES) m above the ellipsoid of what has height zero in the frame: heights there are these and the frame's."""
    flat = nodes.reshape(-1, 3) * np.array([1.0, 1.0, 0.0])
    return wgs84.lonlatheight_from_enu(flat, frame)[:, 2].reshape(NODES, NODES)


def _between(nodes: FloatArray) -> FloatArray:
    """(512, 512): nodes (NODES, NODES) at the middles of the pixels, bilinear."""
    place = (np.arange(RASTER_PX) + 0.5) * (NODES - 1) / RASTER_PX
    low = np.minimum(place.astype(np.int64), NODES - 2)
    share = (place - low)[:, None]
    rows = (1.0 - share) * nodes[low] + share * nodes[low + 1]
    return np.asarray((1.0 - share.T) * rows[:, low] + share.T * rows[:, low + 1])
