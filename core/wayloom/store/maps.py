"""Repository of maps: the places of submaps, the versions, and which blob is which tile."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import ColumnElement, and_, delete, func, insert, or_, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from wayloom.errors import NotFoundError
from wayloom.store.database import now_s
from wayloom.store.tables import ChangedBox, Drive, Map, MapDrive, MapVersion, SubmapRow, TileRow
from wayloom.tiles.formats import SERVED_LAYERS

Box = tuple[float, float, float, float]
"""West, south, east, north in degrees; across the antimeridian east is over 180 (`geodesy.antimeridian.box_of`)."""
PASSES: Final = or_(Drive.gate == "merge", Drive.released_at.is_not(None))
"""Of a drive: it was found good enough for the map, or an operator released it. As `gate.passes`."""


@dataclass(frozen=True, slots=True)
class SubmapPlace:
    """Where a submap lies, without its points: the origin (east, north, up) of its own frame in its cell's, and its box."""

    drive_id: str
    position: int
    frame: tuple[float, float, float]
    origin_enu: tuple[float, float, float]
    box: Box


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


def drives_of(session: Session, map_id: str, number: int) -> Sequence[str]:
    """Ids of the drives that a version holds, sorted; those that have been removed since too."""
    query = select(MapDrive.drive_id).where(MapDrive.map_id == map_id, of_version(MapDrive, number))
    return session.scalars(query.order_by(MapDrive.drive_id)).all()


def of_version(table: type[TileRow | MapDrive], number: int) -> ColumnElement[bool]:
    """Of rows that versions share: they belong to this one."""
    since: InstrumentedAttribute[int] = table.since
    until: InstrumentedAttribute[int | None] = table.until
    return (since <= number) & (until.is_(None) | (until > number))


def tile(session: Session, map_id: str, number: int, layer: str, z: int, x: int, y: int) -> TileRow | None:
    """The tile's entry, None where nothing is mapped."""
    here = (TileRow.map_id == map_id, TileRow.layer == layer, TileRow.z == z, TileRow.x == x, TileRow.y == y)
    return session.scalars(select(TileRow).where(*here, of_version(TileRow, number))).first()


def coverage(session: Session, map_id: str, zoom: int) -> tuple[int, list[tuple[int, int]]]:
    """Where the newest version has tiles of any layer: (zoom, (x, y) in order), at this zoom, or, where it has none, at the next
    coarser one that has any; (0, []) where there is none."""
    number = get(session, map_id).version
    newest = (TileRow.map_id == map_id, of_version(TileRow, number), TileRow.layer.in_(SERVED_LAYERS))
    deepest = session.scalar(select(func.max(TileRow.z)).where(*newest, TileRow.z <= zoom))
    if deepest is None:
        return 0, []
    found = select(TileRow.x, TileRow.y).where(*newest, TileRow.z == deepest).distinct().order_by(TileRow.x, TileRow.y)
    return deepest, [(x, y) for x, y in session.execute(found)]


def place_submaps(session: Session, drive_id: str, rows: Sequence[SubmapRow]) -> None:
    """Put a drive's submaps in the place of those that it had; the map has changed where these were and where the new ones are."""
    mark_changed(session, drive_id)
    session.execute(delete(SubmapRow).where(SubmapRow.drive_id == drive_id))
    session.add_all(rows)
    session.flush()
    mark_changed(session, drive_id)


def mark_changed(session: Session, drive_id: str) -> None:
    """The map is to be stitched anew where this drive's submaps are."""
    session.flush()
    box = (SubmapRow.map_id, SubmapRow.min_lon, SubmapRow.min_lat, SubmapRow.max_lon, SubmapRow.max_lat)
    names = ["map_id", "min_lon", "min_lat", "max_lon", "max_lat"]
    here = select(*box).where(SubmapRow.drive_id == drive_id).order_by(SubmapRow.position)
    session.execute(insert(ChangedBox).from_select(names, here))


def has_submaps(session: Session, drive_id: str) -> bool:
    """Whether the drive has a place in its map."""
    session.flush()
    return session.scalars(select(SubmapRow.position).where(SubmapRow.drive_id == drive_id).limit(1)).first() is not None


def submaps(session: Session, map_id: str, box: Box | None = None) -> Sequence[SubmapRow]:
    """The submaps of a map, or those that touch the box, in an order that does not depend on when they came.

    Those of held and quarantined drives are not of the map.
    """
    query = select(SubmapRow).join(Drive, Drive.id == SubmapRow.drive_id).where(*_merged(map_id))
    if box is not None:
        query = query.where(touches(box))
    return session.scalars(query.order_by(SubmapRow.digest, SubmapRow.drive_id, SubmapRow.position)).all()


def places(session: Session, map_id: str) -> list[SubmapPlace]:
    """Where all submaps of a map lie, by drive and position."""
    row = SubmapRow
    box = (row.min_lon, row.min_lat, row.max_lon, row.max_lat)
    query = (
        select(row.drive_id, row.position, row.frame, row.T_enu_submap, *box)
        .join(Drive, Drive.id == SubmapRow.drive_id)
        .where(*_merged(map_id))
    )
    return [
        SubmapPlace(drive_id, position, tuple(frame), (T[0][3], T[1][3], T[2][3]), (west, south, east, north))
        for drive_id, position, frame, T, west, south, east, north in session.execute(query.order_by(row.drive_id, row.position))
    ]


def _merged(map_id: str) -> tuple[ColumnElement[bool], ...]:
    return SubmapRow.map_id == map_id, Drive.state != "removing", PASSES


def touches(box: Box) -> ColumnElement[bool]:
    """Of a submap: its box touches this one, west <= east, whichever way round the Earth either is written."""
    west, south, east, north = box
    turns = ((SubmapRow.min_lon <= east + turn) & (SubmapRow.max_lon >= west + turn) for turn in (0.0, 360.0, -360.0))
    return and_(or_(*turns), SubmapRow.min_lat <= north, SubmapRow.max_lat >= south)
