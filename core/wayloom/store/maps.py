"""Repository of maps: the places of submaps, the versions, and which blob is which tile."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import ColumnElement, Select, and_, delete, func, insert, or_, select
from sqlalchemy.orm import InstrumentedAttribute, Session, aliased

from wayloom.errors import NotFoundError, WithdrawnError
from wayloom.store.database import now_s
from wayloom.store.spatial.boxes import TURNS, indexed, indexed_near
from wayloom.store.spatial.boxes import Box as Box  # its home for readers of this module
from wayloom.store.tables.drives import Drive, SubmapRow
from wayloom.store.tables.maps import ChangedBox, Map, MapDrive, MapVersion, RegionRow, TileRow
from wayloom.tiles.formats import STATIC_TILES

PASSES: Final = or_(Drive.gate == "merge", Drive.released_at.is_not(None))
"""Of a drive: it was found good enough for the map, or an operator released it. As `gate.passes`."""
IS_GUEST: Final = and_(Drive.gate == "hold", Drive.sound.is_(True), Drive.released_at.is_(None))
"""Of a drive: it is held for its place alone, and its meetings with others may place it. As `gate.is_guest`."""
IN_MAP: Final = or_(PASSES, and_(IS_GUEST, Drive.admitted.is_(True)))
"""Of a drive: the newest version has it, or the next one will. As `gate.is_in_map`."""
CANDIDATE: Final = or_(PASSES, IS_GUEST)
"""Of a drive: a stitch looks at it."""


def submaps_of(session: Session, drive_id: str) -> Sequence[SubmapRow]:
    """The submaps of a drive, in the order of the road."""
    return session.scalars(select(SubmapRow).where(SubmapRow.drive_id == drive_id).order_by(SubmapRow.position)).all()


def candidates(session: Session, map_id: str) -> Sequence[str]:
    """Ids of the drives with submaps that a stitch looks at, guests too, sorted."""
    query = select(SubmapRow.drive_id).join(Drive, Drive.id == SubmapRow.drive_id).where(*_of_map(map_id, CANDIDATE))
    return session.scalars(query.distinct().order_by(SubmapRow.drive_id)).all()


def candidates_near(session: Session, drive_id: str) -> Sequence[str]:
    """Ids of the other drives that a stitch looks at and that may have seen the same street, by both drives' own places; sorted.

    Whether two drives are near each other depends on the two alone; a drive without a place of its own is near none.
    """
    own = aliased(SubmapRow)
    lon = (_turned(SubmapRow.near_min_lon, SubmapRow.near_max_lon, own.near_min_lon, own.near_max_lon, turn) for turn in TURNS)
    lat = (SubmapRow.near_min_lat <= own.near_max_lat, SubmapRow.near_max_lat >= own.near_min_lat)
    touch = and_(indexed_near(session, own), or_(*lon), *lat)
    query = select(SubmapRow.drive_id).join(own, and_(own.drive_id == drive_id, own.map_id == SubmapRow.map_id, touch))
    query = query.join(Drive, Drive.id == SubmapRow.drive_id).where(Drive.id != drive_id, Drive.state != "removing", CANDIDATE)
    return session.scalars(query.distinct().order_by(SubmapRow.drive_id)).all()


@dataclass(frozen=True, slots=True)
class SubmapPlace:
    """Where a submap lies, without its points: the origin (east, north, up) of its own frame in its cell's, and its box.

    frame and box are None where it has no place; is_guest: of a drive whose meetings may place it; admitted: they did in the newest
    version; located: the drive's own geo-reference places it.
    """

    drive_id: str
    position: int
    frame: tuple[float, float, float] | None
    origin_enu: tuple[float, float, float]
    box: Box | None
    is_guest: bool = False
    admitted: bool = False
    located: bool = True


def box_of_row(row: SubmapRow | ChangedBox) -> Box | None:
    """The row's box; None where it has no place."""
    west, south, east, north = row.min_lon, row.min_lat, row.max_lon, row.max_lat
    return None if west is None or south is None or east is None or north is None else (west, south, east, north)


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
    """A published version, the newest by default. Raises NotFoundError, or WithdrawnError for one that held a removed drive."""
    number = get(session, map_id).version if number is None else number
    found = session.get(MapVersion, (map_id, number))
    if found is None:
        raise nothing_published(map_id, number)
    if found.withdrawn_at is not None:
        raise withdrawn_version(map_id, number)
    return found


def nothing_published(map_id: str, number: int | None) -> NotFoundError:
    """Why there is no such version of a map."""
    return NotFoundError(
        f"map {map_id!r} has no version {number}" if number else f"nothing has been published in map {map_id!r} yet"
    )


def withdrawn_version(map_id: str, number: int) -> WithdrawnError:
    """Why a version is not read any more."""
    return WithdrawnError(
        f"version {number} of map {map_id!r} held a drive that was removed, and is withdrawn: drop what you have of it, "
        f"and read the newest, /v1/maps/{map_id}"
    )


def versions(session: Session, map_id: str) -> Sequence[MapVersion]:
    """The versions that are kept and not withdrawn, newest first."""
    get(session, map_id)
    kept = (MapVersion.map_id == map_id, MapVersion.withdrawn_at.is_(None))
    return session.scalars(select(MapVersion).where(*kept).order_by(MapVersion.version.desc())).all()


def drives_of(session: Session, map_id: str, number: int) -> Sequence[str]:
    """Ids of the drives that a version holds, sorted; those that have been removed since too."""
    query = select(MapDrive.drive_id).where(MapDrive.map_id == map_id, of_version(MapDrive, number))
    return session.scalars(query.order_by(MapDrive.drive_id)).all()


def holds(session: Session, map_id: str, drive_id: str) -> bool:
    """Whether the newest version of a map has the drive."""
    query = select(MapDrive.since).where(MapDrive.map_id == map_id, MapDrive.drive_id == drive_id, MapDrive.until.is_(None))
    return session.scalars(query.limit(1)).first() is not None


def of_version(table: type[TileRow | RegionRow | MapDrive], number: int | InstrumentedAttribute[int]) -> ColumnElement[bool]:
    """Of rows that versions share: they belong to this one, or to the version of each row of another table."""
    since: InstrumentedAttribute[int] = table.since
    until: InstrumentedAttribute[int | None] = table.until
    return (since <= number) & (until.is_(None) | (until > number))


def tile(session: Session, map_id: str, number: int, layer: str, z: int, x: int, y: int) -> TileRow | None:
    """The tile's entry, None where nothing is mapped."""
    here = (TileRow.map_id == map_id, TileRow.layer == layer, TileRow.z == z, TileRow.x == x, TileRow.y == y)
    return session.scalars(select(TileRow).where(*here, of_version(TileRow, number))).first()


def digests_of_zoom(session: Session, map_id: str, number: int, layer: str, zoom: int) -> list[str]:
    """The blobs of a layer's tiles of one zoom in a version, in the order of columns and rows."""
    here = (TileRow.map_id == map_id, TileRow.layer == layer, TileRow.z == zoom, of_version(TileRow, number))
    return list(session.scalars(select(TileRow.digest).where(*here).order_by(TileRow.x, TileRow.y)))


def _drives_of(session: Session, map_id: str, number: int | None) -> Select[str]:
    """The drives of a version, by default of the newest, of which there may be none yet. Raises as `version` does."""
    number = get(session, map_id).version if number is None else version(session, map_id, number).version
    return select(MapDrive.drive_id).where(MapDrive.map_id == map_id, of_version(MapDrive, number))


def tracks(session: Session, map_id: str, number: int | None = None) -> list[list[list[float]]]:
    """The ways of a version's drives, by default the newest's, submap by submap and as they lie today: longitudes and latitudes;
    the box's diagonal of a row without. Raises as `version` does."""
    drives = _drives_of(session, map_id, number)
    places = (SubmapRow.map_id == map_id, SubmapRow.min_lon.is_not(None), SubmapRow.drive_id.in_(drives))
    box = (SubmapRow.min_lon, SubmapRow.min_lat, SubmapRow.max_lon, SubmapRow.max_lat)
    rows = session.execute(select(SubmapRow.track, *box).where(*places).order_by(SubmapRow.drive_id, SubmapRow.position))
    return [[place[:2] for place in track] if track else [[west, south], [east, north]] for track, west, south, east, north in rows]


def visits(session: Session, map_id: str, number: int | None = None) -> list[tuple[str, float, list[list[float]]]]:
    """The ways of a version's drives, as of `tracks`: drive, seconds since 1970, longitudes and latitudes."""
    here = (SubmapRow.map_id == map_id, SubmapRow.drive_id.in_(_drives_of(session, map_id, number)))
    ways = select(SubmapRow.drive_id, SubmapRow.track_t_ns, SubmapRow.track).where(*here)
    rows = session.execute(ways.order_by(SubmapRow.drive_id, SubmapRow.position))
    return [(drive_id, t_ns / 1e9, [place[:2] for place in track]) for drive_id, t_ns, track in rows if track]


def coverage(session: Session, map_id: str, zoom: int, number: int | None = None) -> tuple[int, list[tuple[int, int]]]:
    """Where a version, by default the newest, has tiles of the static layer: (zoom, (x, y) in order), at this zoom, or, where it
    has none, at the next coarser one that has any; (0, []) where there is none. Raises as `version` does."""
    number = get(session, map_id).version if number is None else version(session, map_id, number).version
    there = (TileRow.map_id == map_id, of_version(TileRow, number), TileRow.layer.in_(STATIC_TILES))
    deepest = session.scalar(select(func.max(TileRow.z)).where(*there, TileRow.z <= zoom))
    if deepest is None:
        return 0, []
    found = select(TileRow.x, TileRow.y).where(*there, TileRow.z == deepest).distinct().order_by(TileRow.x, TileRow.y)
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
    names = ["map_id", "drive_id", "min_lon", "min_lat", "max_lon", "max_lat"]
    box = [getattr(SubmapRow, name) for name in names]
    here = select(*box).where(SubmapRow.drive_id == drive_id).order_by(SubmapRow.position)
    session.execute(insert(ChangedBox).from_select(names, here))


def has_submaps(session: Session, drive_id: str) -> bool:
    """Whether the drive has a place in its map."""
    session.flush()
    return session.scalars(select(SubmapRow.position).where(SubmapRow.drive_id == drive_id).limit(1)).first() is not None


def submaps(session: Session, map_id: str, box: Box | None = None, with_guests: bool = False) -> Sequence[SubmapRow]:
    """The submaps of a map, or those that touch the box, in an order that does not depend on when they came.

    Those of held and quarantined drives are not of the map; with_guests: those of guests all the same, wherever they have a place.
    """
    which = CANDIDATE if with_guests else IN_MAP
    query = (
        select(SubmapRow).join(Drive, Drive.id == SubmapRow.drive_id).where(*_of_map(map_id, which), SubmapRow.min_lon.is_not(None))
    )
    if box is not None:
        query = query.where(indexed(session, box), touches(box))
    return session.scalars(query.order_by(SubmapRow.digest, SubmapRow.drive_id, SubmapRow.position)).all()


def is_submap(session: Session, digest: str) -> bool:
    """Whether a drive has a submap of this name; one that is being removed has none any more."""
    found = select(SubmapRow.digest).join(Drive, Drive.id == SubmapRow.drive_id)
    named = found.where(SubmapRow.digest == digest, Drive.state != "removing").limit(1)
    return session.scalars(named).first() is not None


def places(session: Session, map_id: str) -> list[SubmapPlace]:
    """Where all submaps lie that a stitch looks at, by drive and position."""
    row = SubmapRow
    box = (row.min_lon, row.min_lat, row.max_lon, row.max_lat)
    about = (IS_GUEST, Drive.admitted, row.located)
    query = (
        select(row.drive_id, row.position, row.frame, row.T_enu_submap, *box, *about)
        .join(Drive, Drive.id == SubmapRow.drive_id)
        .where(*_of_map(map_id, CANDIDATE))
    )
    return [
        SubmapPlace(
            drive_id, position, None if frame is None else tuple(frame), (T[0][3], T[1][3], T[2][3]),
            None if west is None else (west, south, east, north), bool(guest), bool(guest and admitted), located,
        )
        for drive_id, position, frame, T, west, south, east, north, guest, admitted, located in session.execute(
            query.order_by(row.drive_id, row.position)
        )
    ]  # fmt: skip


def _of_map(map_id: str, which: ColumnElement[bool]) -> tuple[ColumnElement[bool], ...]:
    return SubmapRow.map_id == map_id, Drive.state != "removing", which


def touches(box: Box) -> ColumnElement[bool]:
    """Of a submap: its box touches this one, west <= east, whichever way round the Earth either is written. One without a place
    touches none."""
    west, south, east, north = box
    turns = ((SubmapRow.min_lon <= east + turn) & (SubmapRow.max_lon >= west + turn) for turn in TURNS)
    return and_(or_(*turns), SubmapRow.min_lat <= north, SubmapRow.max_lat >= south)


def _turned(
    low: InstrumentedAttribute[float | None],
    high: InstrumentedAttribute[float | None],
    west: InstrumentedAttribute[float | None],
    east: InstrumentedAttribute[float | None],
    turn: float,
) -> ColumnElement[bool]:
    """Of two spans of longitude, one turned round the Earth: they overlap."""
    return and_(low <= east + turn, high >= west + turn)
