"""Repository of maps: the places of submaps, the versions, and which blob is which tile."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Update, delete, func, insert, or_, select, update
from sqlalchemy.orm import Session

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store.database import now_s
from wayloom.store.tables import Drive, Map, MapVersion, SubmapRow, TileRow

OUT_OF_REACH = "lies too far from the map's origin for one grid: give it a map of its own (WAYLOOM_MAP_ID)"
Box = tuple[float, float, float, float]
"""West, south, east, north in degrees; across the antimeridian east is over 180 (`geodesy.antimeridian.box_of`)."""
PASSES: Final = or_(Drive.gate == "merge", Drive.released_at.is_not(None))
"""Of a drive: it was found good enough for the map, or an operator released it. As `gate.passes`."""


@dataclass(frozen=True, slots=True)
class TileEntry:
    """One tile of a version: where it is and which blob it is."""

    layer: str
    z: int
    x: int
    y: int
    digest: str
    media_type: str
    size: int


@dataclass(frozen=True, slots=True)
class NewVersion:
    """What publishing writes.

    frame          longitude, latitude (degrees) and ellipsoidal height (m) of the map frame's origin
    drives         those that are in the map
    out_of_reach   those that lie too far from the frame's origin to be in it
    """

    frame: tuple[float, float, float]
    drives: tuple[str, ...]
    submap_count: int
    bounds: Box | None
    tiles: Sequence[TileEntry]
    facts: dict[str, Any]
    out_of_reach: tuple[str, ...] = ()


def ensure_map(session: Session, map_id: str) -> Map:
    """The map, made when it is not there."""
    found = session.get(Map, map_id)
    if found is None:
        found = Map(id=map_id, version=0, created_at=now_s(session))
        session.add(found)
        session.flush()
    return found


def get(session: Session, map_id: str) -> Map:
    """The map. Raises NotFoundError."""
    found = session.get(Map, map_id)
    if found is None:
        raise NotFoundError(f"there is no map {map_id[:80]!r}")
    return found


def all_maps(session: Session) -> Sequence[Map]:
    """Every map, by name."""
    return session.scalars(select(Map).order_by(Map.id)).all()


def version(session: Session, map_id: str, number: int | None = None) -> MapVersion:
    """A published version, the newest by default. Raises NotFoundError."""
    number = get(session, map_id).version if number is None else number
    found = session.get(MapVersion, (map_id, number))
    if found is None:
        raise NotFoundError(
            f"map {map_id!r} has no version {number}" if number else f"nothing has been published in map {map_id!r} yet"
        )
    return found


def versions(session: Session, map_id: str) -> Sequence[MapVersion]:
    """The versions that are kept, newest first."""
    get(session, map_id)
    return session.scalars(select(MapVersion).where(MapVersion.map_id == map_id).order_by(MapVersion.version.desc())).all()


def tile(session: Session, map_id: str, number: int, layer: str, z: int, x: int, y: int) -> TileRow | None:
    """The tile's entry, None where nothing is mapped."""
    return session.get(TileRow, (map_id, number, layer, z, x, y))


def coverage(session: Session, map_id: str, zoom: int) -> tuple[int, list[tuple[int, int]]]:
    """Where the newest version has tiles of any layer: (zoom, (x, y) in order), at this zoom, or, where it has none, at the next
    coarser one that has any; (0, []) where there is none."""
    of_version = (TileRow.map_id == map_id, TileRow.version == get(session, map_id).version)
    deepest = session.scalar(select(func.max(TileRow.z)).where(*of_version, TileRow.z <= zoom))
    if deepest is None:
        return 0, []
    found = select(TileRow.x, TileRow.y).where(*of_version, TileRow.z == deepest).distinct().order_by(TileRow.x, TileRow.y)
    return deepest, [(x, y) for x, y in session.execute(found)]


def place_submaps(session: Session, drive_id: str, rows: Sequence[SubmapRow]) -> None:
    """Put a drive's submaps in the place of those that it had."""
    session.execute(delete(SubmapRow).where(SubmapRow.drive_id == drive_id))
    session.add_all(rows)


def has_submaps(session: Session, drive_id: str) -> bool:
    """Whether the drive has a place in its map."""
    session.flush()
    return session.scalars(select(SubmapRow.position).where(SubmapRow.drive_id == drive_id).limit(1)).first() is not None


def submaps(session: Session, map_id: str, box: Box | None = None) -> Sequence[SubmapRow]:
    """The submaps of a map, or those that touch the box, in an order that does not depend on when they came.

    Those of held and quarantined drives are not of the map.
    """
    query = select(SubmapRow).join(Drive, Drive.id == SubmapRow.drive_id)
    query = query.where(SubmapRow.map_id == map_id, Drive.state != "removing", PASSES)
    if box is not None:
        west, south, east, north = box
        turns = ((SubmapRow.min_lon <= east + turn) & (SubmapRow.max_lon >= west + turn) for turn in (0.0, 360.0, -360.0))
        query = query.where(or_(*turns), SubmapRow.min_lat <= north, SubmapRow.max_lat >= south)
    return session.scalars(query.order_by(SubmapRow.digest, SubmapRow.drive_id, SubmapRow.position)).all()


def publish(session: Session, map_id: str, new: NewVersion, kept: int) -> int:
    """Write the next version, flip the map's pointer to it, and finish the drives that waited for it. Returns its number.

    Raises ConflictError when another version was published meanwhile.
    """
    before = get(session, map_id).version
    number, now = before + 1, now_s(session)
    session.add(MapVersion(
        map_id=map_id, version=number, created_at=now, frame=list(new.frame), drives=list(new.drives), layers=_layers(new.tiles),
        submap_count=new.submap_count, bounds=None if new.bounds is None else list(new.bounds), tile_count=len(new.tiles),
        byte_count=sum(entry.size for entry in new.tiles), facts=new.facts,
    ))  # fmt: skip
    if new.tiles:
        session.execute(insert(TileRow), [{"map_id": map_id, "version": number, **_columns(entry)} for entry in new.tiles])
    flipped = session.execute(
        update(Map).where(Map.id == map_id, Map.version == before).values(version=number).returning(Map.id)
    ).all()
    if not flipped:
        raise ConflictError(f"map {map_id!r}: another version was published meanwhile")
    taken_in = _stitched_drives(new.drives, "stitching", "failed")  # failed: its own map job was given up, this one has the drive
    session.execute(taken_in.values(state="done", error=None, finished_at=now))
    session.execute(
        _stitched_drives(new.out_of_reach, "stitching", "done").values(state="failed", error=OUT_OF_REACH, finished_at=now)
    )
    for table in (TileRow, MapVersion):
        session.execute(delete(table).where(table.map_id == map_id, table.version <= number - kept))
    return number


def _stitched_drives(drive_ids: Sequence[str], *states: str) -> Update:
    """An update of those of the drives that were given to the map and are in one of the states."""
    return update(Drive).where(Drive.id.in_(drive_ids), Drive.state.in_(states), Drive.stitch_job_id.is_not(None))


def _columns(entry: TileEntry) -> dict[str, Any]:
    return {name: getattr(entry, name) for name in TileEntry.__slots__}


def _layers(entries: Sequence[TileEntry]) -> dict[str, Any]:
    """For each layer: its lowest and highest zoom, its media type and how many tiles it has."""
    layers: dict[str, Any] = {}
    for entry in entries:
        layer = layers.setdefault(
            entry.layer, {"min_zoom": entry.z, "max_zoom": entry.z, "media_type": entry.media_type, "tiles": 0}
        )
        layer["min_zoom"], layer["max_zoom"] = min(layer["min_zoom"], entry.z), max(layer["max_zoom"], entry.z)
        layer["tiles"] += 1
    return layers
