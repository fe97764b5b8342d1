"""State of a map that a stitch starts from: newest version, changed places, frame, and the drives within reach."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import rolled, union_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.grid import KEY_LIMITS
from wayloom.store import map_versions, maps
from wayloom.store.database import Session
from wayloom.store.map_versions import MovedSubmap
from wayloom.store.maps import Box, SubmapPlace
from wayloom.store.tables import SubmapRow
from wayloom_workers.city_alignment import Alignment

FloatArray = NDArray[np.float64]
MARGIN_M: Final = 500.0
"""Of the submaps' own size: they are judged by the place of their origin, and reach 100 m of road and 60 m of sight from it."""
MADE_BY: Final = ("wayloom.stitching.region_files", "wayloom.tiles.updates")
"""The modules whose code makes regions and tiles."""


@dataclass(frozen=True, slots=True)
class PlacedRow:
    """A submap where a version has it; the fields are those of `SubmapRow`."""

    drive_id: str
    position: int
    digest: str
    frame: tuple[float, float, float]
    T_enu_submap: list[Any]
    covariance: list[Any]
    track: list[Any]
    track_t_ns: int
    box: Box


@dataclass(frozen=True, slots=True)
class MapState:
    """Read in one transaction.

    base          the newest version; 0: none
    frame         of the version to come
    built_with    digest of what regions and tiles are made with besides submaps
    boxes         changed since `base`, by id of their rows
    whole         whether everything is made anew: nothing is there yet, or it was made in another frame or by other code
    drives        that are in the map, sorted
    submaps       of them, those within reach: drive and position
    out_of_reach  drives that lie too far from the frame's origin to be in it, sorted
    all_boxes     of every submap within reach, where this version has it
    moved         submaps that lie elsewhere than their rows have them, by drive and position; left the boxes of their rows,
                  reach_deg how far the sides of the two are apart at most
    facts         of the alignment that moved them
    """

    base: int
    frame: MapFrame
    built_with: str
    boxes: dict[int, Box]
    whole: bool
    drives: tuple[str, ...]
    submaps: frozenset[tuple[str, int]]
    out_of_reach: tuple[str, ...]
    all_boxes: Mapping[tuple[str, int], Box]
    moved: Mapping[tuple[str, int], MovedSubmap] = field(default_factory=dict)
    left: tuple[Box, ...] = ()
    reach_deg: float = 0.0
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def bounds(self) -> Box | None:
        """Around all submaps, degrees; as in GeoJSON, across the antimeridian west is the greater."""
        if not self.all_boxes:
            return None
        west, south, east, north = union_of([*self.all_boxes.values()])
        return west, south, rolled(east), north

    @property
    def changed(self) -> list[Box]:
        """Where regions and tiles are to be looked through."""
        changed = {*self.boxes.values(), *self.left, *(one.box for one in self.moved.values())}
        return sorted({*changed, *self.all_boxes.values()} if self.whole else changed)

    def aligned(self, alignment: Alignment) -> "MapState":
        """The state with the submaps where the alignment puts them."""
        moved = {(one.drive_id, one.position): one for one in alignment.moved if (one.drive_id, one.position) in self.submaps}
        boxes = {**self.all_boxes, **{name: one.box for name, one in moved.items()}}
        left = tuple(self.all_boxes[name] for name in moved)
        steps = np.abs(np.array([one.box for one in moved.values()]).reshape(-1, 4) - np.array(left).reshape(-1, 4))
        reach = 1.001 * float(np.minimum(steps, 360.0 - steps).max(initial=0.0))
        return replace(self, all_boxes=boxes, moved=moved, left=left, reach_deg=reach, facts=alignment.facts)

    def rows(self, session: Session, map_id: str, box: Box) -> list[PlacedRow]:
        """The submaps that touch a box where this version has them, in an order that does not depend on when they came."""
        reach = self.reach_deg
        wide = (box[0] - reach, box[1] - reach, box[2] + reach, box[3] + reach)
        found = [self._placed(row) for row in maps.submaps(session, map_id, wide) if (row.drive_id, row.position) in self.submaps]
        return [row for row in found if overlap(row.box, box)]

    def _placed(self, row: SubmapRow) -> PlacedRow:
        moved = self.moved.get((row.drive_id, row.position))
        place: SubmapRow | MovedSubmap = row if moved is None else moved
        box = (row.min_lon, row.min_lat, row.max_lon, row.max_lat) if moved is None else moved.box
        frame = (row.frame[0], row.frame[1], row.frame[2])
        t_ns, track = row.track_t_ns, place.track
        return PlacedRow(row.drive_id, row.position, row.digest, frame, place.T_enu_submap, place.covariance, track, t_ns, box)


def overlap(one: Box, other: Box) -> bool:
    """Whether two boxes touch, whichever way round the Earth either is written. As `maps.touches`."""
    apart = one[3] < other[1] or one[1] > other[3]
    return not apart and any(one[0] <= other[2] + turn and one[2] >= other[0] + turn for turn in (0.0, 360.0, -360.0))


def read_state(session: Session, map_id: str, settings: WayloomSettings) -> MapState:
    """The state of the map as this transaction sees it."""
    base = maps.get(session, map_id).version
    boxes = map_versions.changed_boxes(session, map_id)
    places = maps.places(session, map_id)
    frame, reached = _within_reach(places, settings)
    built_with = _built_with(settings, frame)
    drives = {place.drive_id for place in reached}
    return MapState(
        base=base,
        frame=frame,
        built_with=built_with,
        boxes=boxes,
        whole=not base or maps.version(session, map_id, base).built_with != built_with,
        drives=tuple(sorted(drives)),
        submaps=frozenset((place.drive_id, place.position) for place in reached),
        out_of_reach=tuple(sorted({place.drive_id for place in places} - drives)),
        all_boxes={(place.drive_id, place.position): place.box for place in reached},
    )


def _built_with(settings: WayloomSettings, frame: MapFrame) -> str:
    return sha256_of_json({
        "merge": settings.merge.model_dump(mode="json"),
        "tiles": settings.tiles.model_dump(mode="json"),
        "frame": [frame.lon_deg, frame.lat_deg, frame.height_m],
        "code": [code_version(module).text for module in MADE_BY],
    })  # fmt: skip


def _within_reach(places: list[SubmapPlace], settings: WayloomSettings) -> tuple[MapFrame, list[SubmapPlace]]:
    """The frame of the map and the submaps that its grid can hold: one drive of another city must not stop the map.

    The frame is the settings' origin, or, of the cells that the drives lie in, the most south-western of those that reach the most
    submaps. So it depends on which drives are in the map, never on which came first. A drive of a neighbouring cell is moved over
    exactly: both frames are rigid.
    """
    cells = {place.frame for place in places} if settings.map_origin is None else {settings.map_origin}
    reach_m = KEY_LIMITS * settings.merge.voxel_m - MARGIN_M
    reached = [(MapFrame(*cell), _reached(MapFrame(*cell), places, reach_m)) for cell in sorted(cells)]
    return max(reached, key=lambda item: len(item[1]), default=(MapFrame(0.0, 0.0, 0.0), []))


def _reached(frame: MapFrame, places: list[SubmapPlace], reach: FloatArray) -> list[SubmapPlace]:
    """The submaps, each by the place of its origin, that lie within reach (3,) of the frame's origin along every axis."""
    if not places:
        return []
    moves = {cell: wgs84.T_enu_enu(frame, MapFrame(*cell)) for cell in {place.frame for place in places}}
    origins = np.array([place.origin_enu for place in places])
    T = np.stack([moves[place.frame] for place in places])
    near = (np.abs(np.einsum("nij,nj->ni", T[:, :3, :3], origins) + T[:, :3, 3]) < reach).all(axis=1)
    return [place for place, inside in zip(places, near.tolist(), strict=True) if inside]
