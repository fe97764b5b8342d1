"""Point contents of 3D tiles in glTF 2.0: coloured by class, with class, votes and counts as structured metadata.

Places are whole numbers of 1/256 m in the map's frame, written as float32 around an origin of whole metres: exact within 65 km, so
that what is read back is what was written, and sums over tiles do not depend on where they were cut. Axes are glTF's, as 3D Tiles
turns them: x east, y up, z south.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES, PALETTE
from wayloom.errors import InputError
from wayloom.stitching.voxel_map import VoxelMap

IntArray = NDArray[np.int64]
Place = tuple[int, int, int]
UNITS_PER_M: Final = 256
MOST_BYTES: Final = 1_000_000
MOST_POINTS: Final = 27_500
"""Whose 36 bytes each leave 10 kB of MOST_BYTES for all else in the file."""
NS_PER_DAY: Final = 86_400 * 10**9
MAGIC, JSON_CHUNK, BIN_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
POINTS_MODE, ARRAY_BUFFER = 0, 34962
UINT8, UINT16, FLOAT32 = 5121, 5123, 5126
OFFSETS: Final = {
    "POSITION": 0,
    "COLOR_0": 12,
    "_FEATURE_ID_0": 16,
    "_CONFIDENCE": 20,
    "_DRIVES": 24,
    "_VOXELS": 28,
    "_LAST_SEEN": 32,
}
"""Each attribute of a point begins at a multiple of four bytes, as glTF asks for."""
_FORMATS: Final = [("<f4", 3), ("|u1", 4), "|u1", "|u1", "|u1", "<f4", "<u2"]
VERTEX: Final = np.dtype({"names": [*OFFSETS], "formats": _FORMATS, "offsets": [*OFFSETS.values()], "itemsize": 36})
LINEAR: Final = np.rint(
    255.0 * np.where(PALETTE <= 10, PALETTE / (255.0 * 12.92), ((PALETTE / 255.0 + 0.055) / 1.055) ** 2.4)
).astype(np.uint8)
"""(19, 3) the palette without sRGB's transfer function: glTF's vertex colours are linear."""


@dataclass(frozen=True, slots=True)
class CloudPoints:
    """N points of a 3D tile, sorted by place and label.

    place       (N, 3) int64: east, north, up in the map's frame, 1/256 m
    voxels      (N,) int64: how many voxels of the map each stands for
    label       (N,) train ids; confidence (N,) uint8, 255 = all votes; drives (N,) distinct drives, 255 = that many or more
    last_seen   (N,) uint16: when a drive saw it last, whole days since 1970
    edge        of the cells in which voxels were joined, 1/256 m; 0: each point is one voxel
    """

    place: IntArray
    voxels: IntArray
    label: NDArray[np.uint8]
    confidence: NDArray[np.uint8]
    drives: NDArray[np.uint8]
    last_seen: NDArray[np.uint16]
    edge: int = 0

    def __len__(self) -> int:
        return len(self.place)

    def class_counts(self) -> IntArray:
        """(19,) voxels of each class: the same at every level of detail."""
        found = np.zeros(CLASS_COUNT, np.int64)
        np.add.at(found, self.label, self.voxels)
        return found

    @property
    def box(self) -> tuple[Place, Place]:
        """Its lowest and highest place along each axis."""
        low, high = self.place.min(axis=0).tolist(), self.place.max(axis=0).tolist()
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])

    @property
    def origin_m(self) -> Place:
        """The whole metres in the middle of its box."""
        low, high = self.box
        east, north, up = ((a + b) // (2 * UNITS_PER_M) for a, b in zip(low, high, strict=True))
        return east, north, up


def cloud_of(voxels: VoxelMap) -> CloudPoints:
    """Each voxel as a point."""
    place = np.rint(voxels.points_enu * UNITS_PER_M).astype(np.int64)
    confidence = np.rint(255.0 * voxels.confidence).astype(np.uint8)
    drives = np.minimum(voxels.drives, 255).astype(np.uint8)
    last_seen = np.clip(voxels.last_seen_ns // NS_PER_DAY, 0, 65_535).astype(np.uint16)
    order = np.lexsort((voxels.label, *place.T[::-1]))
    ones = np.ones(len(place), np.int64)
    return CloudPoints(place[order], ones, voxels.label[order], confidence[order], drives[order], last_seen[order])


def joined_cloud(parts: Sequence[CloudPoints], edge: int, limit: int = MOST_POINTS) -> CloudPoints:
    """One point for each cell and class of some parts: counts added, places and votes their means weighed by counts, the most
    drives, the last day.

    edge  : of the cells, 1/256 m; doubled until there are at most `limit` points, or one of each class
    """
    edge = max(edge, *(part.edge for part in parts))
    place, voxels = np.concatenate([part.place for part in parts]), np.concatenate([part.voxels for part in parts])
    label = np.concatenate([part.label for part in parts])
    confidence, drives = np.concatenate([part.confidence for part in parts]), np.concatenate([part.drives for part in parts])
    seen = np.concatenate([part.last_seen for part in parts])
    while True:
        keys, group = np.unique(np.column_stack([place // edge, label]), axis=0, return_inverse=True)
        if len(keys) <= max(limit, CLASS_COUNT):
            break
        edge *= 2
    group = group.reshape(-1)
    total, most, last = np.zeros(len(keys), np.int64), np.zeros(len(keys), np.uint8), np.zeros(len(keys), np.uint16)
    np.add.at(total, group, voxels)
    np.maximum.at(most, group, drives)
    np.maximum.at(last, group, seen)
    means = np.column_stack([_mean(group, voxels, column, total) for column in (*place.T, confidence.astype(np.int64))])
    order = np.lexsort((keys[:, 3], means[:, 2], means[:, 1], means[:, 0]))
    means = means[order]
    label = keys[order, 3].astype(np.uint8)
    return CloudPoints(means[:, :3].copy(), total[order], label, means[:, 3].astype(np.uint8), most[order], last[order], edge)


def _mean(group: IntArray, weight: IntArray, value: IntArray, total: IntArray) -> IntArray:
    """Of each group, rounded to the nearest, in whole numbers: the same on every machine."""
    found = np.zeros(len(total), np.int64)
    np.add.at(found, group, weight * value)
    return np.asarray((2 * found + total) // (2 * total))


def encode_glb(points: CloudPoints) -> bytes:
    """The GLB file of at least one point; equal points give equal bytes.

    `_FEATURE_ID_0` is the train id, the row of the table of classes (EXT_mesh_features), which holds each class's name and how many
    voxels of it the file stands for; `_CONFIDENCE`, `_DRIVES`, `_VOXELS` and `_LAST_SEEN` are properties of each point
    (EXT_structural_metadata).
    """
    origin = points.origin_m
    east, north, up = (points.place - np.array(origin) * UNITS_PER_M).T / UNITS_PER_M
    vertex = np.zeros(len(points), VERTEX)
    vertex["POSITION"] = np.column_stack([east, up, -north])
    vertex["COLOR_0"][:, :3], vertex["COLOR_0"][:, 3] = LINEAR[points.label], 255
    vertex["_FEATURE_ID_0"], vertex["_CONFIDENCE"], vertex["_DRIVES"] = points.label, points.confidence, points.drives
    vertex["_VOXELS"], vertex["_LAST_SEEN"] = points.voxels, points.last_seen
    names = [name.encode() for name in CLASS_NAMES]
    offsets = np.cumsum([0, *map(len, names)]).astype("<u4")
    pieces = [vertex.tobytes(), b"".join(names), offsets.tobytes(), points.class_counts().astype("<u4").tobytes()]
    views, body = _packed(pieces)
    views[0] |= {"byteStride": VERTEX.itemsize, "target": ARRAY_BUFFER}
    document = _document(vertex, len(np.unique(points.label)), {"origin_m": list(origin), "edge": points.edge})
    return _glb(document | {"bufferViews": views, "buffers": [{"byteLength": len(body)}]}, body)


def decode_glb(data: bytes, name: str = "3D tile") -> CloudPoints:
    """The inverse of `encode_glb`. Raises InputError for bytes that it has not written."""
    try:
        magic, version, length, size, kind = struct.unpack_from("<4sIIII", data)
        if magic != MAGIC or version != 2 or length != len(data) or kind != JSON_CHUNK:
            raise ValueError(f"it begins with {data[:8]!r}")
        document = json.loads(data[20 : 20 + size])
        count, said = int(document["accessors"][0]["count"]), document["extras"]
        vertex = np.frombuffer(data, VERTEX, count, 28 + size)
        x, y, z = (vertex["POSITION"].astype(np.float64) * UNITS_PER_M).astype(np.int64).T
        place = np.column_stack([x, -z, y]) + np.array(said["origin_m"], np.int64) * UNITS_PER_M
        label, confidence, drives, seen = (vertex[key].copy() for key in ("_FEATURE_ID_0", "_CONFIDENCE", "_DRIVES", "_LAST_SEEN"))
        return CloudPoints(place, vertex["_VOXELS"].astype(np.int64), label, confidence, drives, seen, int(said["edge"]))
    except (ValueError, KeyError, TypeError, IndexError, struct.error) as error:
        raise InputError(f"is no 3D tile or is damaged ({error})", file=name, remedy="have the map stitched anew") from error


def _packed(pieces: Sequence[bytes]) -> tuple[list[dict[str, Any]], bytes]:
    """Views of a buffer with all pieces, each at a multiple of eight bytes, as structured metadata asks for."""
    views, body = [], bytearray()
    for piece in pieces:
        body += bytes(-len(body) % 8)
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(piece)})
        body += piece
    return views, bytes(body)


def _document(vertex: NDArray[Any], classes: int, extras: dict[str, Any]) -> dict[str, Any]:
    position = vertex["POSITION"]
    box = {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
    kinds: dict[str, dict[str, Any]] = {
        "POSITION": {"componentType": FLOAT32, "type": "VEC3"} | box,
        "COLOR_0": {"componentType": UINT8, "type": "VEC4", "normalized": True},
        "_FEATURE_ID_0": {"componentType": UINT8, "type": "SCALAR"},
        "_CONFIDENCE": {"componentType": UINT8, "type": "SCALAR", "normalized": True},
        "_DRIVES": {"componentType": UINT8, "type": "SCALAR"},
        "_VOXELS": {"componentType": FLOAT32, "type": "SCALAR"},
        "_LAST_SEEN": {"componentType": UINT16, "type": "SCALAR"},
    }
    accessors = [{"bufferView": 0, "byteOffset": OFFSETS[key], "count": len(vertex)} | kind for key, kind in kinds.items()]
    features = {"featureIds": [{"featureCount": classes, "attribute": 0, "label": "semantic", "propertyTable": 0}]}
    primitive = {
        "mode": POINTS_MODE,
        "material": 0,
        "attributes": {key: row for row, key in enumerate(kinds)},
        "extensions": {"EXT_mesh_features": features, "EXT_structural_metadata": {"propertyAttributes": [0]}},
    }
    return {
        "asset": {"version": "2.0", "generator": "wayloom"},
        "extensionsUsed": ["EXT_mesh_features", "EXT_structural_metadata", "KHR_materials_unlit"],
        "extensions": {"EXT_structural_metadata": METADATA},
        "extras": extras,
        "materials": [{"extensions": {"KHR_materials_unlit": {}}}],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
        "accessors": accessors,
    }


def _scalar(kind: str, description: str, **more: bool) -> dict[str, Any]:
    return {"type": "SCALAR", "componentType": kind, "description": description, "required": True} | more


METADATA: Final[dict[str, Any]] = {
    "schema": {
        "id": "wayloom",
        "classes": {
            "semantic": {
                "properties": {
                    "name": {"type": "STRING", "required": True},
                    "voxels": _scalar("UINT32", "voxels of the map that the tile's points of this class stand for"),
                }
            },
            "point": {
                "properties": {
                    "confidence": _scalar("UINT8", "share of the votes that the class has", normalized=True),
                    "drives": _scalar("UINT8", "distinct drives that saw it; 255: that many or more"),
                    "voxels": _scalar("FLOAT32", "voxels of the map that it stands for"),
                    "last_seen": _scalar("UINT16", "when a drive saw it last: whole days since 1970"),
                }
            },
        },
    },
    "propertyTables": [
        {
            "class": "semantic",
            "count": CLASS_COUNT,
            "properties": {"name": {"values": 1, "stringOffsets": 2}, "voxels": {"values": 3}},
        }
    ],
    "propertyAttributes": [
        {
            "class": "point",
            "properties": {
                "confidence": {"attribute": "_CONFIDENCE"},
                "drives": {"attribute": "_DRIVES"},
                "voxels": {"attribute": "_VOXELS"},
                "last_seen": {"attribute": "_LAST_SEEN"},
            },
        }
    ],
}
"""The table of classes, and the properties of points."""


def _glb(document: dict[str, Any], body: bytes) -> bytes:
    text = json.dumps(document, sort_keys=True, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body += bytes(-len(body) % 4)
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(body), BIN_CHUNK) + body
    return MAGIC + struct.pack("<II", 2, 12 + len(chunks)) + chunks
