"""Versions of a map: written from what changed since the one before, in one transaction that flips the map's pointer.

Tiles, regions and drives are rows that versions share: `since` the version that brought them, `until` the one that ended them. So a
version costs what changed, and every version that is kept stays readable whole.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Update, delete, insert, select, tuple_, update
from sqlalchemy.orm import InstrumentedAttribute, Session

from wayloom.errors import ConflictError
from wayloom.store import maps
from wayloom.store.database import now_s
from wayloom.store.etas.told import settle
from wayloom.store.history import note_event
from wayloom.store.maps import Box, box_of_row
from wayloom.store.tables.drives import Drive, SubmapRow
from wayloom.store.tables.maps import ChangedBox, Map, MapDrive, MapVersion, RegionRow, TileRow
from wayloom.store.withdrawal import withdraw
from wayloom.tiles.formats import SERVED_LAYERS

OUT_OF_REACH = "lies too far from the map's origin for one grid: give it a map of its own (WAYLOOM_MAP_ID)"
BATCH = 200
"""Rows asked for by their keys in one statement: databases limit how many values one may have."""
T = TypeVar("T")
TileKey = tuple[str, int, int, int]
"""Layer, zoom, column, row."""
RegionKey = tuple[int, int]
"""Column from the west, row from the south, of the grid of regions."""
KeyBox = tuple[RegionKey, RegionKey]
"""The first column and row, and the last."""
REGION_FEATURES = ("markings", "areas", "objects")
"""Columns of regions that name files of their features."""


@dataclass(frozen=True, slots=True)
class TileEntry:
    """One tile: where it is and which blob it is."""

    layer: str
    z: int
    x: int
    y: int
    digest: str
    media_type: str
    size: int

    @property
    def key(self) -> TileKey:
        """Its address."""
        return self.layer, self.z, self.x, self.y


@dataclass(frozen=True, slots=True)
class RegionEntry:
    """One region: where it is, what it was made from (`RegionRow`), which blob it is, what has gone from it and is new, and which
    blobs its ground, markings, areas and objects are (empty: it has none).

    changes : GeoJSON features, points with the properties of `wayloom.stitching.change.Change`
    """

    east: int
    north: int
    inputs: str
    digest: str
    members: list[list[str]]
    size: int
    changes: list[dict[str, Any]] = field(default_factory=list)
    ground: str = ""
    markings: str = ""
    areas: str = ""
    objects: str = ""

    @property
    def key(self) -> RegionKey:
        """Its place in the grid."""
        return self.east, self.north


@dataclass(frozen=True, slots=True)
class MovedSubmap:
    """A submap and its place by the city graph, as in `SubmapRow`; own_T_enu_submap tells the row that was moved. Without frame and
    box it loses its place."""

    drive_id: str
    position: int
    digest: str
    own_T_enu_submap: list[list[float]]
    T_enu_submap: list[list[float]]
    covariance: list[list[float]]
    track: list[list[float]]
    frame: list[float] | None
    box: Box | None

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "MovedSubmap":
        """The inverse of `dataclasses.asdict`, whose tuples JSON has made lists."""
        return cls(**{**content, "box": None if content["box"] is None else tuple(content["box"])})


@dataclass(frozen=True, slots=True)
class NewVersion:
    """What publishing writes.

    base           the version that the changes are against; 0: none
    frame          longitude, latitude (degrees) and ellipsoidal height (m) of the map frame's origin
    drives         all that are in the map
    tiles, dropped_tiles      those that are new or another than in `base`, and those that are no more
    regions, dropped_regions  likewise
    moved          submaps that the city graph places elsewhere than `base` has them
    taken_in       ids of the changed boxes that this version has taken in
    out_of_reach   drives that lie too far from the frame's origin to be in it
    verdicts       on guests that this version has judged, by their ids: `wayloom.stitching.admission.Verdict` as JSON
    """

    base: int
    frame: tuple[float, float, float]
    drives: tuple[str, ...]
    submap_count: int
    bounds: Box | None
    tiles: Sequence[TileEntry]
    dropped_tiles: Sequence[TileKey] = ()
    regions: Sequence[RegionEntry] = ()
    dropped_regions: Sequence[RegionKey] = ()
    moved: Sequence[MovedSubmap] = ()
    taken_in: Sequence[int] = ()
    facts: dict[str, Any] = field(default_factory=dict)
    built_with: str = ""
    out_of_reach: tuple[str, ...] = ()
    verdicts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def publish(session: Session, map_id: str, new: NewVersion, kept: int, stitch_job_id: int | None = None) -> int:
    """Write the next version, flip the map's pointer to it, finish the drives that waited for it, and withdraw the versions that
    hold a removed drive. Returns its number.

    stitch_job_id : the job that stitched it; drives that it takes in count as its, also one that a later job was asked for

    Raises ConflictError when another version than `new.base` is the newest by now.
    """
    before = maps.get(session, map_id).version
    if before != new.base:
        raise ConflictError(f"map {map_id!r}: version {before} was published while the changes of {new.base} were stitched")
    number, now = before + 1, now_s(session)
    counted = _replace_tiles(session, map_id, number, new)
    _replace_regions(session, map_id, number, new)
    _replace_drives(session, map_id, number, new.drives)
    for one in new.moved:
        _move(session, one)
    session.add(MapVersion(
        map_id=map_id, version=number, created_at=now, frame=list(new.frame), built_with=new.built_with,
        drive_count=len(new.drives), submap_count=new.submap_count, bounds=None if new.bounds is None else list(new.bounds),
        layers=counted.layers, tile_count=counted.tiles, byte_count=counted.bytes, facts=new.facts,
    ))  # fmt: skip
    flipped = session.execute(
        update(Map).where(Map.id == map_id, Map.version == before).values(version=number).returning(Map.id)
    ).all()
    if not flipped:
        raise ConflictError(f"map {map_id!r}: another version was published meanwhile")
    _write_verdicts(session, new.verdicts, now)
    _finish_drives(session, map_id, number, new.out_of_reach, now, stitch_job_id)
    settle(session, Drive.map_id == map_id)
    for some in _batches(new.taken_in):
        session.execute(delete(ChangedBox).where(ChangedBox.map_id == map_id, ChangedBox.id.in_(some)))
    _forget(session, map_id, number - kept)
    withdraw(session, map_id)
    return number


def current_tiles(session: Session, map_id: str, keys: Iterable[TileKey]) -> dict[TileKey, TileEntry]:
    """Those of the newest version among these addresses."""
    return {key: _entry(row) for key, row in _current_rows(session, map_id, keys).items()}


def _current_rows(session: Session, map_id: str, keys: Iterable[TileKey]) -> dict[TileKey, TileRow]:
    """By columns and rows of each layer's zoom, which the primary key finds; what else lies at their crossings is left out."""
    wanted: dict[tuple[str, int], set[TileKey]] = {}
    for key in keys:
        wanted.setdefault(key[:2], set()).add(key)
    found: dict[TileKey, TileRow] = {}
    for (layer, z), members in sorted(wanted.items()):
        for some in _batches(sorted(members, key=lambda key: key[2:])):
            columns, rows = sorted({key[2] for key in some}), sorted({key[3] for key in some})
            here = (TileRow.map_id == map_id, TileRow.layer == layer, TileRow.z == z, TileRow.x.in_(columns), TileRow.y.in_(rows))
            for row in session.scalars(select(TileRow).where(*here, TileRow.until.is_(None))):
                found[row.layer, row.z, row.x, row.y] = row
    return {key: row for key, row in found.items() if key in wanted[key[:2]]}


def _entry(row: TileRow) -> TileEntry:
    return TileEntry(row.layer, row.z, row.x, row.y, row.digest, row.media_type, row.size)


def all_current_tiles(session: Session, map_id: str) -> dict[TileKey, TileEntry]:
    """All of the newest version."""
    rows = session.scalars(select(TileRow).where(TileRow.map_id == map_id, TileRow.until.is_(None)))
    return {entry.key: entry for entry in map(_entry, rows)}


def current_regions(session: Session, map_id: str, keys: Iterable[RegionKey] | None = None) -> dict[RegionKey, RegionEntry]:
    """Those of the newest version among these, or all."""
    query = select(RegionRow).where(RegionRow.map_id == map_id, RegionRow.until.is_(None))
    place = tuple_(RegionRow.east, RegionRow.north)
    queries = [query] if keys is None else [query.where(place.in_(some)) for some in _batches(sorted(keys))]
    rows = [row for one in queries for row in session.scalars(one)]
    return {(row.east, row.north): _region(row) for row in rows}


def region_made_from(session: Session, map_id: str, key: RegionKey, inputs: str) -> RegionEntry | None:
    """A region of any version that is kept, made from the same inputs."""
    here = (RegionRow.map_id == map_id, RegionRow.east == key[0], RegionRow.north == key[1], RegionRow.inputs == inputs)
    row = session.scalars(select(RegionRow).where(*here).limit(1)).first()
    return None if row is None else _region(row)


def _region(row: RegionRow) -> RegionEntry:
    about = (row.east, row.north, row.inputs, row.digest, row.members, row.size, row.changes)
    return RegionEntry(*about, row.ground, row.markings, row.areas, row.objects)


def regions_with(session: Session, map_id: str, number: int, of: str, within: KeyBox | None = None) -> list[tuple[RegionKey, str]]:
    """The regions of a version that have features of a kind of REGION_FEATURES, with the digests of these, by column and row.

    within : the first and the last column and row to look at; None: everywhere
    """
    digest: InstrumentedAttribute[str] = getattr(RegionRow, of)
    here = [RegionRow.map_id == map_id, maps.of_version(RegionRow, number), digest != ""]
    if within is not None:
        (west, south), (east, north) = within
        here += [RegionRow.east.between(west, east), RegionRow.north.between(south, north)]
    rows = session.execute(select(RegionRow.east, RegionRow.north, digest).where(*here).order_by(RegionRow.east, RegionRow.north))
    return [((column, row), found) for column, row, found in rows]


def changed_things(session: Session, map_id: str) -> list[dict[str, Any]]:
    """What has gone and is new in the newest version, as features, by region."""
    here = (RegionRow.map_id == map_id, RegionRow.until.is_(None), RegionRow.change_count > 0)
    rows = session.scalars(select(RegionRow).where(*here).order_by(RegionRow.east, RegionRow.north))
    return [feature for row in rows for feature in row.changes]


def changes_of_regions(session: Session, map_id: str, number: int) -> list[tuple[RegionKey, list[dict[str, Any]]]]:
    """What a version lists as gone and new, as features, by column and row of the regions that have any."""
    here = (RegionRow.map_id == map_id, maps.of_version(RegionRow, number), RegionRow.change_count > 0)
    columns = select(RegionRow.east, RegionRow.north, RegionRow.changes)
    rows = session.execute(columns.where(*here).order_by(RegionRow.east, RegionRow.north))
    return [((east, north), features) for east, north, features in rows]


def things_of_version(session: Session, map_id: str, number: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Of a version: the changed things that it lists and the one before did not, and those that it lists no more, as features."""
    query = select(RegionRow).where(RegionRow.map_id == map_id, RegionRow.change_count > 0)
    order = (RegionRow.east, RegionRow.north)
    after, before = (
        [one for row in session.scalars(query.where(which == number).order_by(*order)) for one in row.changes]
        for which in (RegionRow.since, RegionRow.until)
    )
    return [one for one in after if one not in before], [one for one in before if one not in after]


def changed_boxes(session: Session, map_id: str) -> dict[int, Box | None]:
    """Where the map is to be stitched anew, by id of the row; None for a submap without a place."""
    rows = session.scalars(select(ChangedBox).where(ChangedBox.map_id == map_id).order_by(ChangedBox.id))
    return {row.id: box_of_row(row) for row in rows}


def changed_drives(session: Session, map_id: str) -> Sequence[str]:
    """Ids of the drives whose submaps came, went or were placed anew since, sorted; some may be gone."""
    return session.scalars(
        select(ChangedBox.drive_id).where(ChangedBox.map_id == map_id).distinct().order_by(ChangedBox.drive_id)
    ).all()


def changes(session: Session, map_id: str, number: int) -> tuple[Sequence[TileRow], Sequence[TileRow]]:
    """Of a version: the served tiles that it brought, and those that it ended without a new one in their place."""
    served = (TileRow.map_id == map_id, TileRow.layer.in_(SERVED_LAYERS))
    order = (TileRow.layer, TileRow.z, TileRow.x, TileRow.y)
    new = session.scalars(select(TileRow).where(*served, TileRow.since == number).order_by(*order)).all()
    replaced = {(row.layer, row.z, row.x, row.y) for row in new}
    ended = session.scalars(select(TileRow).where(*served, TileRow.until == number).order_by(*order)).all()
    return new, [row for row in ended if (row.layer, row.z, row.x, row.y) not in replaced]


@dataclass(frozen=True, slots=True)
class _Counted:
    """layers as `MapVersion.layers`; tiles and bytes of all served layers."""

    layers: dict[str, Any]
    tiles: int
    bytes: int


def _replace_tiles(session: Session, map_id: str, number: int, new: NewVersion) -> _Counted:
    """End the rows of tiles that go or change, write those that come, and count."""
    before = session.get(MapVersion, (map_id, new.base)) if new.base else None
    zooms: dict[str, dict[str, int]] = {} if before is None else {name: dict(it["zooms"]) for name, it in before.layers.items()}
    types = {} if before is None else {name: it["media_type"] for name, it in before.layers.items()}
    size = 0 if before is None else before.byte_count
    ended = _current_rows(session, map_id, [*(entry.key for entry in new.tiles), *new.dropped_tiles])
    for row in ended.values():
        row.until = number
    session.flush()
    if new.tiles:
        columns = [{name: getattr(entry, name) for name in TileEntry.__slots__} for entry in new.tiles]
        session.execute(insert(TileRow), [{"map_id": map_id, "since": number, "until": None, **row} for row in columns])
    for entries, step in ((map(_entry, ended.values()), -1), (new.tiles, 1)):
        for entry in entries:
            if entry.layer in SERVED_LAYERS:
                by_zoom = zooms.setdefault(entry.layer, {})
                by_zoom[str(entry.z)] = by_zoom.get(str(entry.z), 0) + step
                types[entry.layer] = entry.media_type
                size += step * entry.size
    layers = {name: _layer(types[name], by_zoom) for name, by_zoom in sorted(zooms.items()) if any(by_zoom.values())}
    return _Counted(layers, sum(layer["tiles"] for layer in layers.values()), size)


def _layer(media_type: str, by_zoom: Mapping[str, int]) -> dict[str, Any]:
    zooms = {zoom: count for zoom, count in sorted(by_zoom.items(), key=lambda item: int(item[0])) if count}
    numbers = [int(zoom) for zoom in zooms]
    about = {"min_zoom": min(numbers), "max_zoom": max(numbers), "media_type": media_type}
    return {**about, "tiles": sum(zooms.values()), "zooms": zooms}


def _replace_regions(session: Session, map_id: str, number: int, new: NewVersion) -> None:
    ended = [*(entry.key for entry in new.regions), *new.dropped_regions]
    for some in _batches(sorted(ended)):
        here = (RegionRow.map_id == map_id, RegionRow.until.is_(None), tuple_(RegionRow.east, RegionRow.north).in_(some))
        session.execute(update(RegionRow).where(*here).values(until=number))
    if new.regions:
        columns = [asdict(entry) | {"change_count": len(entry.changes)} for entry in new.regions]
        session.execute(insert(RegionRow), [{"map_id": map_id, "since": number, "until": None, **row} for row in columns])


def _replace_drives(session: Session, map_id: str, number: int, drives: Sequence[str]) -> None:
    """Those of the version. A drive that was removed is another one where it has been sent again since."""
    newest = (MapDrive.map_id == map_id, MapDrive.until.is_(None))
    session.execute(update(MapDrive).where(*newest, MapDrive.removed.is_(True)).values(until=number))
    before, after = set(session.scalars(select(MapDrive.drive_id).where(*newest))), set(drives)
    for some in _batches(sorted(before - after)):
        gone = (MapDrive.map_id == map_id, MapDrive.until.is_(None), MapDrive.drive_id.in_(some))
        session.execute(update(MapDrive).where(*gone).values(until=number))
    came = [{"map_id": map_id, "drive_id": drive_id, "since": number, "until": None} for drive_id in sorted(after - before)]
    if came:
        session.execute(insert(MapDrive), came)


def _forget(session: Session, map_id: str, newest: int) -> None:
    """The versions up to this one, and the rows that none after it has."""
    session.execute(delete(MapVersion).where(MapVersion.map_id == map_id, MapVersion.version <= newest))
    for table in (TileRow, RegionRow, MapDrive):
        session.execute(delete(table).where(table.map_id == map_id, table.until <= newest + 1))


def _move(session: Session, moved: MovedSubmap) -> None:
    """Place a submap, unless its drive was processed anew or removed meanwhile: then the next stitch will."""
    row = session.get(SubmapRow, (moved.drive_id, moved.position))
    if row is not None and (row.digest, row.own_T_enu_submap or row.T_enu_submap) == (moved.digest, moved.own_T_enu_submap):
        row.own_T_enu_submap, row.own_covariance = moved.own_T_enu_submap, row.own_covariance or row.covariance
        row.T_enu_submap, row.covariance, row.track = moved.T_enu_submap, moved.covariance, moved.track
        row.frame = moved.frame
        row.min_lon, row.min_lat, row.max_lon, row.max_lat = moved.box or (None, None, None, None)


def _write_verdicts(session: Session, verdicts: Mapping[str, Mapping[str, Any]], now: float) -> None:
    """Guests that are admitted are done, the others are held. One that was judged anew, released or removed meanwhile is no guest
    of this version any more: the next stitch has it."""
    for some in _batches(sorted(verdicts)):
        here = (Drive.id.in_(some), Drive.state != "removing", maps.IS_GUEST)
        for drive in session.scalars(select(Drive).where(*here).order_by(Drive.id)):
            drive.map_verdict = dict(verdicts[drive.id])
            drive.admitted = bool(drive.map_verdict["admitted"])
            was_asked = drive.state in ("stitching", "done", "held") or (
                drive.state == "failed" and drive.stitch_job_id is not None
            )
            state = "done" if drive.admitted else "held"
            if was_asked and drive.state != state:
                drive.state, drive.error, drive.finished_at = state, None, now
            if not drive.admitted:
                drive.stitch_job_id = None
    session.flush()


def _finish_drives(
    session: Session, map_id: str, number: int, out_of_reach: Sequence[str], now: float, stitch_job_id: int | None
) -> None:
    """Those that are in the map are done, by this job, also one whose own map job was given up or has not begun; those out of its
    reach have failed."""
    held = select(MapDrive.drive_id).where(MapDrive.map_id == map_id, MapDrive.until.is_(None))
    taken_in = _stitched_drives(Drive.id.in_(held), "stitching", "failed")
    by = {} if stitch_job_id is None else {"stitch_job_id": stitch_job_id}
    done = {"state": "done", "error": None, "finished_at": now, **by}
    for drive_id in session.scalars(taken_in.values(done).returning(Drive.id)).all():
        note_event(session, drive_id, "publish", "done", text=f"the drive is in the map since version {number}")
    left_out = _stitched_drives(Drive.id.in_(out_of_reach), "stitching", "done")
    failed = {"state": "failed", "error": OUT_OF_REACH, "finished_at": now}
    for drive_id in session.scalars(left_out.values(failed).returning(Drive.id)).all():
        note_event(session, drive_id, "publish", "failed", text=OUT_OF_REACH)


def _stitched_drives(which: ColumnElement[bool], *states: str) -> Update:
    """An update of those of the drives that were given to the map and are in one of the states."""
    return update(Drive).where(which, Drive.state.in_(states), Drive.stitch_job_id.is_not(None))


def _batches(items: Sequence[T]) -> Iterable[Sequence[T]]:
    return (items[start : start + BATCH] for start in range(0, len(items), BATCH))
