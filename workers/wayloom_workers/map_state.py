"""State of a map that a stitch starts from: newest version, changed places, frame, and the drives within reach."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import overlap, rolled, union_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.admission import Verdict
from wayloom.store import map_versions, maps
from wayloom.store.database import Session
from wayloom.store.map_versions import MovedSubmap
from wayloom.store.maps import Box, SubmapPlace
from wayloom.store.tables.drives import SubmapRow
from wayloom_workers.city_alignment import Alignment
from wayloom_workers.drive_pairs import Candidates
from wayloom_workers.map_reach import reach_of

FloatArray = NDArray[np.float64]
MADE_BY: Final = (
    "wayloom.stitching.regions", "wayloom.stitching.region_files", "wayloom.tiles.updates", "wayloom.ground.merge",
    "wayloom.tiles.ground_tiles", "wayloom.stitching.region_markings", "wayloom.stitching.region_areas",
    "wayloom.stitching.region_objects",     "wayloom.tiles.feature_tiles",
)  # fmt: skip
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
    frame         of the version to come; reach_m how far from its origin along each axis a submap may begin
    built_with    digest of what regions and tiles are made with besides submaps
    boxes         changed since `base`, by id of their rows
    whole         whether everything is made anew: nothing is there yet, or it was made in another frame or by other code
    candidates    the submaps within reach that the alignment is to look at, with those of guests
    drives        that are in the map, sorted
    submaps       of them, those within reach: drive and position
    admitted      the guests among them
    out_of_reach  drives that lie too far from the frame's origin to be in it, sorted
    all_boxes     of every candidate within reach, where its row has it; None without a place
    moved         submaps that lie elsewhere than their rows have them, by drive and position
    turned        guests that come with this version, or go
    reach_deg     how far the sides of a moved submap's box are from those of its row's, at most
    facts         of the alignment that moved them, and its verdicts on guests
    """

    base: int
    frame: MapFrame
    reach_m: tuple[float, float, float]
    built_with: str
    boxes: dict[int, Box | None]
    whole: bool
    candidates: Candidates
    drives: tuple[str, ...]
    submaps: frozenset[tuple[str, int]]
    admitted: frozenset[str]
    out_of_reach: tuple[str, ...]
    all_boxes: Mapping[tuple[str, int], Box | None]
    moved: Mapping[tuple[str, int], MovedSubmap] = field(default_factory=dict)
    turned: frozenset[str] = frozenset()
    reach_deg: float = 0.0
    facts: Mapping[str, Any] = field(default_factory=dict)
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)

    @property
    def bounds(self) -> Box | None:
        """Around all submaps, degrees; as in GeoJSON, across the antimeridian west is the greater."""
        boxes = [*self._boxes_now().values()]
        if not boxes:
            return None
        west, south, east, north = union_of(boxes)
        return west, south, rolled(east), north

    @property
    def changed(self) -> list[Box]:
        """Where regions and tiles are to be looked through."""
        left = (box for name, box in self.all_boxes.items() if name in self.moved or name[0] in self.turned)
        came = (one.box for one in self.moved.values())
        changed = {box for box in (*self.boxes.values(), *left, *came) if box is not None}
        return sorted({*changed, *self._boxes_now().values()} if self.whole else changed)

    def _boxes_now(self) -> dict[tuple[str, int], Box]:
        """The boxes of the submaps of this version."""
        found = {name: self.moved[name].box if name in self.moved else self.all_boxes[name] for name in sorted(self.submaps)}
        return {name: box for name, box in found.items() if box is not None}

    def aligned(self, alignment: Alignment) -> "MapState":
        """The state with the submaps where the alignment puts them, and with the guests that it admits."""
        moved = {(one.drive_id, one.position): one for one in alignment.moved}
        judged = {name: verdict.admitted for name, verdict in alignment.verdicts.items()}
        guests = frozenset(name for name in self.candidates.guests if judged.get(name, name in self.admitted))
        members = self.candidates.reached - self.candidates.guests
        here = {name for name in self.candidates.submaps if name[0] in members | guests and self._reaches(moved.get(name))}
        return replace(
            self,
            drives=tuple(sorted({drive_id for drive_id, _ in here})),
            submaps=frozenset(here),
            admitted=guests,
            moved=moved,
            turned=guests ^ self.admitted,
            reach_deg=_reach_deg([(self.all_boxes.get(name), one.box) for name, one in moved.items()]),
            facts=alignment.facts,
            verdicts=alignment.verdicts,
        )

    def _reaches(self, moved: MovedSubmap | None) -> bool:
        """Whether the map's grid holds a submap that gets its place only now; others have moved by metres at most."""
        if moved is None or self.all_boxes[moved.drive_id, moved.position] is not None:
            return True
        return all(abs(moved.T_enu_submap[axis][3]) < self.reach_m[axis] for axis in range(3))

    def rows(self, session: Session, map_id: str, box: Box) -> list[PlacedRow]:
        """The submaps that touch a box where this version has them, in an order that does not depend on when they came."""
        reach = self.reach_deg
        wide = (box[0] - reach, box[1] - reach, box[2] + reach, box[3] + reach)
        found = [*maps.submaps(session, map_id, wide, with_guests=True), *self._without_place(session, box)]
        placed = [self._placed(row) for row in found if (row.drive_id, row.position) in self.submaps]
        return sorted((row for row in placed if overlap(row.box, box)), key=lambda row: (row.digest, row.drive_id, row.position))

    def _without_place(self, session: Session, box: Box) -> list[SubmapRow]:
        """The rows that have no box to be found by, and get one in this box by this version."""
        names = [
            name
            for name, one in self.moved.items()
            if self.all_boxes.get(name) is None and one.box is not None and overlap(one.box, box)
        ]
        rows = (session.get(SubmapRow, name) for name in names)
        return [row for row in rows if row is not None and row.digest == self.moved[row.drive_id, row.position].digest]

    def _placed(self, row: SubmapRow) -> PlacedRow:
        moved = self.moved.get((row.drive_id, row.position))
        place: SubmapRow | MovedSubmap = row if moved is None else moved
        box = maps.box_of_row(row) if moved is None else moved.box
        assert place.frame is not None
        assert box is not None
        frame = (place.frame[0], place.frame[1], place.frame[2])
        t_ns, track = row.track_t_ns, place.track
        return PlacedRow(row.drive_id, row.position, row.digest, frame, place.T_enu_submap, place.covariance, track, t_ns, box)


def _reach_deg(boxes: Sequence[tuple[Box | None, Box | None]]) -> float:
    """How far the sides of two boxes are apart at most; those that are missing are not asked."""
    both = [pair for pair in boxes if None not in pair]
    one, other = (np.array([pair[side] for pair in both], np.float64).reshape(-1, 4) for side in (0, 1))
    steps = np.abs(one - other)
    return 1.001 * float(np.minimum(steps, 360.0 - steps).max(initial=0.0))


def read_state(session: Session, map_id: str, settings: WayloomSettings) -> MapState:
    """The state of the map as this transaction sees it."""
    base = maps.get(session, map_id).version
    boxes = map_versions.changed_boxes(session, map_id)
    places = maps.places(session, map_id)
    frame, reach_m, reached = _within_reach(places, settings)
    built_with = _built_with(settings, frame)
    admitted = frozenset(place.drive_id for place in reached if place.admitted)
    within = frozenset(place.drive_id for place in reached)
    inside = [place for place in reached if not place.is_guest or place.admitted]
    return MapState(
        base=base,
        frame=frame,
        reach_m=reach_m,
        built_with=built_with,
        boxes=boxes,
        whole=not base or maps.version(session, map_id, base).built_with != built_with,
        candidates=_candidates(places, reached),
        drives=tuple(sorted({place.drive_id for place in inside})),
        submaps=frozenset((place.drive_id, place.position) for place in inside),
        admitted=admitted,
        out_of_reach=tuple(sorted({place.drive_id for place in places if not place.is_guest} - within)),
        all_boxes={(place.drive_id, place.position): place.box for place in reached},
    )


def _candidates(places: Sequence[SubmapPlace], reached: Sequence[SubmapPlace]) -> Candidates:
    return Candidates(
        submaps=frozenset((place.drive_id, place.position) for place in reached),
        guests=frozenset(place.drive_id for place in places if place.is_guest),
        loose=frozenset(place.drive_id for place in reached if not place.located),
    )


def _built_with(settings: WayloomSettings, frame: MapFrame) -> str:
    return sha256_of_json({
        "merge": settings.merge.model_dump(mode="json"),
        "tiles": settings.tiles.model_dump(mode="json"),
        "markings": settings.markings.model_dump(mode="json"),
        "kerbs": settings.kerbs.model_dump(mode="json"),
        "areas": settings.areas.model_dump(mode="json"),
        "objects": settings.object_fusion.model_dump(mode="json"),
        "frame": [frame.lon_deg, frame.lat_deg, frame.height_m],
        "code": [code_version(module).text for module in MADE_BY],
    })  # fmt: skip


def _within_reach(
    places: Sequence[SubmapPlace], settings: WayloomSettings
) -> tuple[MapFrame, tuple[float, float, float], list[SubmapPlace]]:
    """The frame of the map and the submaps that its grid can hold: one drive of another city must not stop the map.

    The frame is the settings' origin, or, of the cells that the drives lie in, the most south-western of those that reach the
    most submaps. So it depends on which drives are in the map, never on which came first; guests are not asked. A drive of a
    neighbouring cell is moved over exactly: both frames are rigid. Drives without a place are within reach of any map with others.
    """
    reach_m = reach_of(settings)
    members = [place for place in places if not place.is_guest]
    cells = {place.frame for place in members if place.frame is not None}
    cells = cells if settings.map_origin is None else {settings.map_origin}
    reached = [(MapFrame(*cell), _reached(MapFrame(*cell), members, reach_m)) for cell in sorted(cells)]
    frame, inside = max(reached, key=lambda item: len(item[1]), default=(MapFrame(0.0, 0.0, 0.0), []))
    guests = [place for place in places if place.is_guest and place.located]
    loose = [place for place in places if not place.located] if inside else []
    east, north, up = (float(limit) for limit in reach_m)
    return frame, (east, north, up), [*inside, *_reached(frame, guests, reach_m), *loose]


def _reached(frame: MapFrame, places: Sequence[SubmapPlace], reach: FloatArray) -> list[SubmapPlace]:
    """The submaps, each by the place of its origin, that lie within reach (3,) of the frame's origin along every axis."""
    placed = [(place, place.frame) for place in places if place.frame is not None]
    if not placed:
        return []
    moves = {cell: wgs84.T_enu_enu(frame, MapFrame(*cell)) for cell in {cell for _, cell in placed}}
    origins = np.array([place.origin_enu for place, _ in placed])
    T = np.stack([moves[cell] for _, cell in placed])
    near = (np.abs(np.einsum("nij,nj->ni", T[:, :3, :3], origins) + T[:, :3, 3]) < reach).all(axis=1)
    return [place for (place, _), inside in zip(placed, near.tolist(), strict=True) if inside]
