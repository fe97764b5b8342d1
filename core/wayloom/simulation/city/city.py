"""Lazily built city geometry: blocks over the terrain, cut into chunks for view-frustum culling."""

import threading
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.city import polygons
from wayloom.simulation.city.block_context import SignalFace
from wayloom.simulation.city.blocks import SURROUNDINGS_M, build_block
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.markings import TrueKerb, TrueMarking, true_kerbs, true_markings
from wayloom.simulation.city.objects import Area, Change, TrueArea, TrueObject
from wayloom.simulation.city.streets import F64, StreetGraph
from wayloom.simulation.city.terrain import FLAT, HILLS, Terrain
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.models.mesh import Mesh, empty, join

CHUNK_M = 24.0
FINE_M, FARTHEST_M = 170.0, 450.0
"""Up to which distance blocks are seen in full, and up to which at all, m."""
TALLEST_M, DEEPEST_M, OVERHANG_M = 30.0, 3.0, 4.0
"""What stands in a block stays within these heights over and under its corners, and so far outside its streets' middles."""
STEEPEST = 0.08
BORDER_M = SURROUNDINGS_M + 16.0
"""How far a block's outskirts reach; streets do not run straight along the city's border."""
FINE_KEPT, COARSE_KEPT = 64, 180
"""How many blocks are kept: about 3 MB each, and 1 MB."""


@dataclass(frozen=True, slots=True)
class Tile:
    """A block over the terrain. mesh is ordered by chunk: chunk c holds its triangles starts[c] to starts[c + 1], within
    low[c] to high[c] (C, 3) m."""

    mesh: Mesh
    starts: NDArray[np.int64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    objects: tuple[TrueObject, ...]
    changes: tuple[Change, ...]
    faces: tuple[SignalFace, ...]


@dataclass(frozen=True, slots=True)
class Chunks:
    """Chosen chunks: (tile, number of the chunk in it), in order."""

    chosen: list[tuple[Tile, int]]

    def __len__(self) -> int:
        return len(self.chosen)


class City:
    """Lazily built city: each block is built when first needed, from its own random streams; only the last used are kept."""

    def __init__(self, settings: CitySettings, models: Models) -> None:
        self.settings, self.models = settings, models
        self.graph = StreetGraph(settings)
        self.ground: Terrain = FLAT if settings.hard else HILLS
        self._kept: dict[bool, OrderedDict[int, Tile]] = {False: OrderedDict(), True: OrderedDict()}
        self._lock = threading.Lock()

    @property
    def seed(self) -> int:
        """Seed of all its random streams."""
        return self.settings.seed

    def tile(self, block: int, coarse: bool = False) -> Tile:
        """A block in full detail, or in coarse detail for far views."""
        kept = self._kept[coarse]
        with self._lock:
            if block not in kept:
                kept[block] = self._built(block, coarse)
                while len(kept) > (COARSE_KEPT if coarse else FINE_KEPT):
                    kept.popitem(last=False)
            kept.move_to_end(block)
            return kept[block]

    def chunks(self, chosen: Chunks) -> Mesh:
        """The triangles of the chunks chosen, in that order."""
        parts = [tile.mesh.rows(slice(int(tile.starts[c]), int(tile.starts[c + 1]))) for tile, c in chosen.chosen]
        return join(parts) if parts else empty()

    def around(self, x: float, y: float, reach_m: float) -> Chunks:
        """Chunks that overlap a square of half edge reach_m; of blocks farther than FINE_M in coarse detail."""
        out: list[tuple[Tile, int]] = []
        for block, distance in self._blocks(x, y, reach_m):
            tile = self.tile(block, distance > FINE_M)
            near = (tile.low[:, 0] < x + reach_m) & (tile.high[:, 0] > x - reach_m)
            near &= (tile.low[:, 1] < y + reach_m) & (tile.high[:, 1] > y - reach_m)
            out += [(tile, int(c)) for c in np.nonzero(near)[0]]
        return Chunks(out)

    def visible(self, planes: F64, reach: F64, origin: F64) -> Chunks:
        """Chunks not wholly outside one of the planes of the view from `origin` (3,) m, nearest first.

        planes (6, 3) inward unit normals, reach (6,) m how far outside of each one still sees; nothing beyond FARTHEST_M.
        """
        found: list[tuple[Tile, NDArray[np.int64]]] = []
        for block, distance in self._blocks(float(origin[0]), float(origin[1]), FARTHEST_M):
            if distance < FARTHEST_M and len(_inside(*self._box(block), planes, reach, origin)):
                tile = self.tile(block, distance > FINE_M)
                found.append((tile, _inside(tile.low, tile.high, planes, reach, origin)))
        gaps = [np.linalg.norm(np.clip(origin, tile.low[rows], tile.high[rows]) - origin, axis=1) for tile, rows in found]
        if not gaps:
            return Chunks([])
        chosen = [(tile, int(c)) for tile, rows in found for c in rows]
        return Chunks([chosen[i] for i in np.argsort(np.concatenate(gaps), kind="stable")])

    def objects(self, area: Area | None = None) -> list[TrueObject]:
        """Poles, signs and signal heads in an area (the whole city without one), in a fixed order."""
        found = (thing for block in self._blocks_of(area) for thing in self.tile(block).objects)
        return [thing for thing in found if area is None or area.holds(*thing.foot[:2])]

    def changes(self, area: Area | None = None) -> list[Change]:
        """Differences of a changed city from the unchanged one of the same seed; none in the latter."""
        found = (change for block in self._blocks_of(area) for change in self.tile(block).changes)
        return [change for change in found if area is None or area.holds(*change.foot[:2])]

    def areas(self, area: Area | None = None) -> list[TrueArea]:
        """Roads, sidewalks and lawns of all blocks that touch an area (the whole city without one)."""
        return polygons.areas(self.settings, self.graph, self.ground, self._blocks_of(area))

    def markings(self, area: Area | None = None) -> list[TrueMarking]:
        """Road markings around all blocks that touch an area (the whole city without one)."""
        return true_markings(self.graph, self.ground, self._blocks_of(area))

    def kerbs(self, area: Area | None = None) -> list[TrueKerb]:
        """Kerbs of all blocks that touch an area (the whole city without one)."""
        return true_kerbs(self.graph, self.ground, self._blocks_of(area))

    def faces(self, x: float, y: float, reach_m: float) -> list[SignalFace]:
        """Signal heads near x, y, m."""
        found = (face for block, _ in self._blocks(x, y, reach_m) for face in self.tile(block).faces)
        return [face for face in found if np.hypot(face.at[0] - x, face.at[1] - y) < reach_m]

    def whole(self) -> Mesh:
        """All triangles of the city in full, block by block; for small cities."""
        return join([self.tile(block).mesh for block in range(self.graph.block_count)])

    def _blocks_of(self, area: Area | None) -> list[int]:
        if area is None:
            return list(range(self.graph.block_count))
        return self.graph.blocks_within(np.array(area.low) - OVERHANG_M, np.array(area.high) + OVERHANG_M)

    def _blocks(self, x: float, y: float, reach_m: float) -> list[tuple[int, float]]:
        """Blocks, outskirts included, that may reach into a square of half edge reach_m, each with its distance from x, y, m."""
        here, reach = np.array([x, y]), reach_m + BORDER_M
        out = []
        for block in self.graph.blocks_within(here - reach, here + reach):
            low, high = self._box(block)
            gap = np.maximum(0.0, np.maximum(low[0, :2] - here, here - high[0, :2]))
            if gap.max() < reach_m:
                out.append((block, float(np.hypot(*gap))))
        return out

    def _box(self, block: int) -> tuple[F64, F64]:
        """Bounding box, (1, 3) m low and high, of a block with its outskirts, without building it."""
        corners = self.graph.nodes[list(self.graph.loop(block))]
        z = self.ground.height(corners[:, 0], corners[:, 1])
        wide = BORDER_M if self.graph.is_at_border(block) else OVERHANG_M
        hills = STEEPEST * wide  # beyond the corners
        low = np.append(corners.min(axis=0) - wide, z.min() - DEEPEST_M - hills)
        high = np.append(corners.max(axis=0) + wide, z.max() + TALLEST_M + hills)
        return low[None], high[None]

    def _built(self, block: int, coarse: bool) -> Tile:
        built = build_block(self.settings, self.graph, self.models, block, coarse)
        mesh, starts, low, high = _chunked(_lifted(built.mesh, self.ground))
        objects = tuple(replace(thing, foot=self._lifted_point(thing.foot)) for thing in built.objects)
        changes = tuple(replace(change, foot=self._lifted_point(change.foot)) for change in built.changes)
        faces = tuple(replace(face, at=self._lifted_point(face.at)) for face in built.faces)
        return Tile(mesh, starts, low, high, objects, changes, faces)

    def _lifted_point(self, p: F64) -> F64:
        return np.array([p[0], p[1], p[2] + float(self.ground.height(p[0], p[1]))])


def build_city(settings: CitySettings, models: Models) -> City:
    """A city with no block built yet."""
    return City(settings, models)


def _inside(
    low: NDArray[np.float32] | F64, high: NDArray[np.float32] | F64, planes: F64, reach: F64, origin: F64
) -> NDArray[np.int64]:
    """Rows of the boxes low to high (B, 3) m that are not wholly outside one of the planes."""
    kept = np.ones(len(low), bool)
    for plane, beyond in zip(planes, reach, strict=True):
        farthest = np.where(plane > 0, high, low)  # the corner of each box that lies farthest inside
        kept &= (farthest - origin) @ plane > -beyond
    return np.nonzero(kept)[0]


def _lifted(mesh: Mesh, ground: Terrain) -> Mesh:
    """The flat city raised by the terrain's height under each corner. Uprights stay upright; slopes are too gentle to tilt."""
    corners = mesh.corners.copy()
    corners[..., 2] += ground.height(corners[..., 0].astype(float), corners[..., 1].astype(float)).astype(np.float32)
    return replace(mesh, corners=corners)


def _chunked(mesh: Mesh) -> tuple[Mesh, NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Triangles ordered by the square of CHUNK_M m in which their middle lies, and the box of each square's triangles."""
    cell = np.floor(mesh.corners[..., :2].mean(axis=1) / CHUNK_M).astype(np.int64)
    cell -= cell.min(axis=0)
    key = cell[:, 1] * (cell[:, 0].max() + 1) + cell[:, 0]
    order = np.argsort(key, kind="stable")
    mesh, key = mesh.rows(order), key[order]
    first = np.nonzero(np.r_[True, np.diff(key) > 0])[0]
    low = np.minimum.reduceat(mesh.corners.min(axis=1), first, axis=0)
    high = np.maximum.reduceat(mesh.corners.max(axis=1), first, axis=0)
    return mesh, np.append(first, len(mesh)), low, high
