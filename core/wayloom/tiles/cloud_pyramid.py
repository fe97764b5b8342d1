"""Levels of detail of the 3D tiles: point contents from the voxels up, and the tilesets that bind them.

A block's voxels are whole in its finest tiles: in one, or, where they are too many for it, in smaller ones below. Each coarser tile
joins the points of the four below it, those that have not changed as they are stored. So a pyramid that was updated is equal to one
built at once, byte for byte, and the counts of each class are the same at every level.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.layer_names import LAYERS, STATIC
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.formats import Tile, tile_layer, tile_of
from wayloom.tiles.gltf_points import CloudPoints, cloud_of, decode_glb, encode_glb, joined_cloud
from wayloom.tiles.grid import TILE_PX, TileAddress, ancestor, children, pixel_from_lonlat, row_by_row
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.tileset import CloudNode, decode_tileset, encode_root, encode_tileset, node_of, without_children

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LEVELS_A_FILE: Final = 3
"""Zooms of tiles in a tileset's file; the next below is in files of its own."""
EDGE: Final = 32
EDGE_ZOOM: Final = 18
"""Cells are 1/8 m (32 units of 1/256 m) at this zoom, and twice as wide at each coarser one: about 1000 along a tile's edge."""


class CloudSource(Protocol):
    """What an update reads of the map, as it is after the change."""

    def voxels(self, block: TileAddress) -> VoxelMap:
        """Those of a block, and perhaps some around it; always in the same order."""

    def stored(self, name: str, address: TileAddress) -> bytes | None:
        """The tile of a format that was there before the change, for one that the change does not touch."""


def top_zoom(settings: TileSettings) -> int:
    """The coarsest zoom of 3D tiles: the top of a tileset's file."""
    block = settings.block_zoom
    return block - max(block - settings.min_zoom, 0) // LEVELS_A_FILE * LEVELS_A_FILE


def file_zoom(zoom: int, settings: TileSettings) -> int:
    """The zoom of the tile whose tileset's file describes the tiles of this zoom."""
    above = max(settings.block_zoom - zoom, 0)
    return min(zoom, settings.block_zoom) - (-above) % LEVELS_A_FILE


def cloud_tiles(changed: Collection[TileAddress], source: CloudSource, settings: TileSettings) -> Iterator[Tile]:
    """The 3D tiles, contents and tilesets, of the changed blocks and of all above them."""
    update = CloudUpdate(changed, source, settings)
    for block in sorted(changed, key=row_by_row):
        voxels = source.voxels(block)
        assert voxels.frame is not None
        lon_lat = wgs84.lonlatheight_from_enu(voxels.points_enu, voxels.frame)[:, :2]
        yield from update.block(block, voxels, lon_lat)


def root_of(tilesets: Iterable[bytes], frame: MapFrame, up: str = ".", of: str = LAYERS[STATIC]) -> bytes:
    """The tileset of a layer of a map from the files of its top zoom; their folders lie in `up`, relative to it."""
    return encode_root([without_children(decode_tileset(data)) for data in tilesets], frame, folders_of(of), up)


def folders_of(of: str) -> tuple[str, str]:
    """The layers of contents and of tilesets that show a layer of the map."""
    return tile_layer("glb", of), tile_layer("tileset", of)


class CloudUpdate:
    """One update, block by block: a coarser tile is made as soon as the last changed block in it was, and points that no tile waits
    for are dropped."""

    def __init__(
        self, changed: Collection[TileAddress], source: CloudSource, settings: TileSettings, of: str = LAYERS[STATIC]
    ) -> None:
        self._source, self._settings, self._of = source, settings, of
        zooms = range(settings.block_zoom, top_zoom(settings) - 1, -1)
        self._touched = {zoom: frozenset(ancestor(block, zoom) for block in changed) for zoom in zooms}
        self._waiting = Counter(ancestor(one, zoom - 1) for zoom in zooms[:-1] for one in self._touched[zoom])
        self._nodes: dict[TileAddress, CloudNode] = {}
        self._points: dict[TileAddress, CloudPoints] = {}
        self._files: dict[TileAddress, dict[TileAddress, CloudNode]] = {}

    def block(self, block: TileAddress, voxels: VoxelMap, lon_lat: FloatArray) -> Iterator[Tile]:
        """The tiles of a changed block and those above it that it is the last of, from its voxels among these, which lie at lon_lat
        (V, 2) degrees."""
        pixels = pixel_from_lonlat(lon_lat, self._settings.max_zoom)
        inside = np.flatnonzero((self._tiles_of(pixels, block.z) == (block.x, block.y)).all(axis=1))
        if len(inside):
            self._nodes[block], self._points[block], tiles = self._finest(block, voxels.take(inside), pixels[inside])
            yield from tiles
            yield self._tileset(self._nodes[block])
        address = block
        while address.z - 1 in self._touched:
            address = ancestor(address, address.z - 1)
            self._waiting[address] -= 1
            if self._waiting[address]:
                return
            yield from self._coarser(address)

    def _finest(self, address: TileAddress, voxels: VoxelMap, pixels: IntArray) -> tuple[CloudNode, CloudPoints, list[Tile]]:
        """A tile of a block and all below it."""
        parts = []
        if len(voxels) <= self._settings.cloud_points_per_tile:
            points = cloud_of(voxels)
        elif address.z >= self._settings.max_zoom:
            points = self._joined([cloud_of(voxels)], address.z)
        else:
            places = self._tiles_of(pixels, address.z + 1)
            for child in children(address):
                rows = np.flatnonzero((places == (child.x, child.y)).all(axis=1))
                if len(rows):
                    parts.append(self._finest(child, voxels.take(rows), pixels[rows]))
            points = self._joined([part[1] for part in parts], address.z)
        node = node_of(address, points, [part[0] for part in parts])
        return node, points, [tile_of("glb", address, encode_glb(points), self._of), *(tile for part in parts for tile in part[2])]

    def _coarser(self, address: TileAddress) -> Iterator[Tile]:
        """A tile from the four below it, and its tileset where it has one of its own."""
        below = [node for child in children(address) if (node := self._node(child)) is not None]
        if not below:
            return
        points = self._joined([self._points_of(node.address) for node in below], address.z)
        for node in below:
            self._points.pop(node.address, None)
        self._points[address] = points
        self._nodes[address] = node_of(address, points, [without_children(node) for node in below])
        yield tile_of("glb", address, encode_glb(points), self._of)
        if file_zoom(address.z, self._settings) == address.z:
            tree = self._tree(address, address.z + LEVELS_A_FILE)
            linked = frozenset(node.address for node in tree.walk() if node.address.z == address.z + LEVELS_A_FILE)
            yield self._tileset(tree, linked)

    def _tileset(self, tree: CloudNode, linked: frozenset[TileAddress] = frozenset()) -> Tile:
        return tile_of("tileset", tree.address, encode_tileset(tree, folders_of(self._of), linked), self._of)

    def _tree(self, address: TileAddress, links: int) -> CloudNode:
        """A tile and all below it, down to the links of its file."""
        node = self._node(address)
        assert node is not None
        below = () if address.z == links else tuple(self._tree(child.address, links) for child in node.children)
        return replace(node, children=below)

    def _points_of(self, address: TileAddress) -> CloudPoints:
        if address in self._points:
            return self._points[address]
        data = self._source.stored("glb", address)
        return decode_glb(b"" if data is None else data, f"3D tile {address}")

    def _node(self, address: TileAddress) -> CloudNode | None:
        """A tile, a block or coarser, as it is after the change; None where nothing is."""
        if address in self._touched[address.z]:
            return self._nodes.get(address)
        home = ancestor(address, file_zoom(address.z, self._settings))
        if home not in self._files:
            data = self._source.stored("tileset", home)
            nodes = () if data is None else decode_tileset(data, f"tileset {home}").walk()
            self._files[home] = {node.address: node for node in nodes}
        return self._files[home].get(address)

    def _joined(self, parts: Sequence[CloudPoints], zoom: int) -> CloudPoints:
        edge = EDGE << (EDGE_ZOOM - zoom) if zoom <= EDGE_ZOOM else max(EDGE >> (zoom - EDGE_ZOOM), 1)
        return joined_cloud(parts, edge, self._settings.cloud_points_per_tile)

    def _tiles_of(self, pixels: IntArray, zoom: int) -> IntArray:
        """(N, 2) column, row of the tiles in which pixels (N, 2) of the finest zoom lie."""
        return (pixels // TILE_PX) >> (self._settings.max_zoom - zoom)
