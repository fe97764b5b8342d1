"""3D Tiles 1.1 tilesets: a tree of tiles by explicit addresses, with links to the files of the trees below.

Tiles have the axes of the map's frame and origins of whole metres, so a tile's transform is a shift, written exactly; the root's
alone turns the frame to the Earth's (ECEF). A file is a function of the tiles that it names: equal tiles, equal bytes.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.tiles.gltf_points import UNITS_PER_M, CloudPoints, Place
from wayloom.tiles.grid import TileAddress

ERROR_EDGES: Final = 4.0
"""Geometric error in edges of the cells in which voxels were joined: at the 16 pixels that viewers allow, a point every four."""


@dataclass(frozen=True, slots=True)
class CloudNode:
    """A tile of the tree.

    origin_m  of its content, whole metres in the map's frame
    low, high the box of its content and of all below, 1/256 m
    edge      of the cells of its content (`CloudPoints.edge`); 0: it is as fine as the map is, or as its tiles get
    children  those in the same file
    """

    address: TileAddress
    origin_m: Place
    low: Place
    high: Place
    edge: int
    children: tuple["CloudNode", ...] = ()

    def walk(self) -> Iterator["CloudNode"]:
        """It and all below, in the same file."""
        yield self
        for child in self.children:
            yield from child.walk()


def node_of(address: TileAddress, points: CloudPoints, children: Sequence[CloudNode] = ()) -> CloudNode:
    """The tile of these points; with children it is refined by them."""
    boxes = [points.box, *((child.low, child.high) for child in children)]
    low, high = _around(boxes)
    return CloudNode(address, points.origin_m, low, high, points.edge if children else 0, tuple(children))


def _around(boxes: Sequence[tuple[Place, Place]]) -> tuple[Place, Place]:
    """The box around some; a flat one gets a thickness, as it would have no volume."""
    low = np.array([low for low, _ in boxes]).min(axis=0)
    high = np.maximum(np.array([high for _, high in boxes]).max(axis=0), low + 1)
    return _place(low), _place(high)


def _place(values: NDArray[Any]) -> Place:
    east, north, up = values.tolist()
    return int(east), int(north), int(up)


def encode_tileset(node: CloudNode, folders: tuple[str, str], linked: frozenset[TileAddress] = frozenset()) -> bytes:
    """The file of a tree.

    folders : layers of contents and of tilesets, across which files refer to each other
    linked  : tiles of it that stand for files of their own: `z/x/y.json` of the tilesets, where this one lies too
    """
    root = _tile(node, node.origin_m, linked, "../../..", folders)
    return _file(root, node, {"origin_m": list(node.origin_m)})


def decode_tileset(data: bytes, name: str = "tileset") -> CloudNode:
    """The tree of a file of `encode_tileset`; linked tiles have no children. Raises InputError for bytes that are none."""
    try:
        document = json.loads(data)
        east, north, up = document["extras"]["origin_m"]
        return _node(document["root"], (int(east), int(north), int(up)))
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"is no tileset of a map ({error})", file=name, remedy="have the map stitched anew") from error


def encode_root(nodes: Sequence[CloudNode], frame: MapFrame, folders: tuple[str, str], up: str = ".") -> bytes:
    """The tileset of a whole map, at least one file of `encode_tileset`.

    nodes   : the roots of these files
    folders : layers of contents and of tilesets
    up      : where they lie, relative to it
    """
    low, high = _around([(node.low, node.high) for node in nodes])
    whole = CloudNode(TileAddress(0, 0, 0), (0, 0, 0), low, high, 2 * max(node.edge for node in nodes))
    tiles = [_tile(one, (0, 0, 0), frozenset({one.address}), up, folders) for one in sorted(nodes, key=lambda node: node.address)]
    root = _bounded(whole, (0, 0, 0)) | {"transform": _column_major(_earth_transform(frame)), "children": tiles}
    return _file(root, whole)


def _earth_transform(frame: MapFrame) -> NDArray[np.float64]:
    """T_ecef_enu (4, 4), rounded to 1e-15 and, in its last column, to 1e-8 m: to digits that every machine agrees on."""
    T = wgs84.T_ecef_enu(frame)
    return np.column_stack([T[:, :3].round(15), T[:, 3].round(8)])


def _tile(node: CloudNode, parent_m: Place, linked: frozenset[TileAddress], up: str, folders: tuple[str, str]) -> dict[str, Any]:
    """A tile, relative to the origin of the one above."""
    is_link = node.address in linked
    folder, suffix = (folders[1], "json") if is_link else (folders[0], "glb")
    z, x, y = node.address
    found = _bounded(node, node.origin_m) | {"content": {"uri": f"{up}/{folder}/{z}/{x}/{y}.{suffix}"}}
    shift = [float(here - there) for here, there in zip(node.origin_m, parent_m, strict=True)]
    if any(shift):
        found["transform"] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, *shift, 1.0]
    if node.children and not is_link:
        found["children"] = [_tile(child, node.origin_m, linked, up, folders) for child in node.children]
    return found


def _bounded(node: CloudNode, origin_m: Place) -> dict[str, Any]:
    low, high = (np.array(one) / UNITS_PER_M - np.array(origin_m) for one in (node.low, node.high))
    box = [*((low + high) / 2.0).tolist(), *np.diag((high - low) / 2.0).ravel().tolist()]
    return {"boundingVolume": {"box": box}, "geometricError": node.edge * ERROR_EDGES / UNITS_PER_M, "refine": "REPLACE"}


def _node(tile: dict[str, Any], parent_m: Place) -> CloudNode:
    shift = tile.get("transform", [0.0] * 16)[12:15]
    east, north, up = (int(there + by) for there, by in zip(parent_m, shift, strict=True))
    origin = (east, north, up)
    box = np.array(tile["boundingVolume"]["box"])
    middle, half = box[:3] + np.array(origin), np.diag(box[3:].reshape(3, 3))
    low, high = ((middle + sign * half) * UNITS_PER_M for sign in (-1.0, 1.0))
    z, x, y = tile["content"]["uri"].rpartition(".")[0].split("/")[-3:]
    edge = int(tile["geometricError"] * UNITS_PER_M / ERROR_EDGES)
    children = tuple(_node(child, origin) for child in tile.get("children", ()))
    return CloudNode(TileAddress(int(z), int(x), int(y)), origin, _place(np.rint(low)), _place(np.rint(high)), edge, children)


def without_children(node: CloudNode) -> CloudNode:
    """As a link shows it."""
    return replace(node, children=())


def _column_major(T: NDArray[np.float64]) -> list[float]:
    found: list[float] = T.T.ravel().tolist()
    return found


def _file(root: dict[str, Any], node: CloudNode, extras: dict[str, Any] | None = None) -> bytes:
    error = max(2 * node.edge, UNITS_PER_M) * ERROR_EDGES / UNITS_PER_M
    document = {"asset": {"version": "1.1"}, "geometricError": error, "root": root} | ({"extras": extras} if extras else {})
    return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()
