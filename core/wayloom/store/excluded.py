"""Repository of excluded areas: places of a map of which nothing is kept."""

import uuid
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from sqlalchemy import ColumnElement, and_, delete, exists, or_, select
from sqlalchemy.orm import Session

from wayloom.errors import NotFoundError
from wayloom.exclusion.areas import Area, area_of_geometry, plain_geometry
from wayloom.store import maps, runs
from wayloom.store.database import now_s
from wayloom.store.jobs import JobMessage, request_stitch
from wayloom.store.maps import Box, of_version
from wayloom.store.spatial.boxes import indexed
from wayloom.store.tables.drives import Drive, Job, SubmapRow
from wayloom.store.tables.maps import ExcludedArea, MapVersion, TileRow
from wayloom.store.withdrawal import withdraw_versions
from wayloom.tiles.grid import TILE_PX, pixel_from_lonlat

MARGIN_M: Final = 25.0
"""Around an area's box, from which submaps are looked at: more than any of them is clipped beyond its border."""
METRES_A_DEGREE: Final = 110_000.0
ZOOMS: Final = range(14, 23)
"""Whose tiles tell whether a version shows an area."""
SERVICE, SETTINGS = "service", "settings"


def add(
    session: Session, map_id: str, name: str, geometry: dict[str, Any], source: str = SERVICE
) -> tuple[ExcludedArea, JobMessage]:
    """Keep nothing of an area from now on: the map's next version, whose job is returned, is made without it. Raises InputError."""
    area = area_of_geometry(geometry)
    maps.ensure_map(session, map_id)
    sides = dict(zip(("min_lon", "min_lat", "max_lon", "max_lat"), area.box, strict=True))
    row = ExcludedArea(
        id=uuid.uuid4().hex, map_id=map_id, name=name, geometry=geometry, source=source, created_at=now_s(session), **sides
    )
    session.add(row)
    session.flush()
    job = request_stitch(session, map_id)
    return row, JobMessage(job.id, job.queue)


def remove(session: Session, area_id: str) -> None:
    """Let drives that come from now on be kept there again; what was dropped does not come back. Raises NotFoundError."""
    row = session.get(ExcludedArea, area_id)
    if row is None:
        raise NotFoundError(f"there is no excluded area {area_id[:80]!r}")
    session.delete(row)


def of_map(session: Session, map_id: str) -> Sequence[ExcludedArea]:
    """The areas of a map, oldest first."""
    query = select(ExcludedArea).where(ExcludedArea.map_id == map_id)
    return session.scalars(query.order_by(ExcludedArea.created_at, ExcludedArea.id)).all()


def sync(session: Session, map_id: str, found: Iterable[tuple[str, dict[str, Any]]]) -> None:
    """Make the areas of the settings these, by name and geometry."""
    known = {(row.name, str(plain_geometry(row.geometry))): row for row in of_map(session, map_id) if row.source == SETTINGS}
    wanted = {(name, str(geometry)): (name, geometry) for name, geometry in found}
    gone = [row.id for key, row in known.items() if key not in wanted]
    session.execute(delete(ExcludedArea).where(ExcludedArea.id.in_(gone)))
    for key in sorted(wanted.keys() - known.keys()):
        add(session, map_id, *wanted[key], SETTINGS)


def area_of(row: ExcludedArea) -> Area:
    """Its polygons."""
    return area_of_geometry(row.geometry)


def rows_near(session: Session, area: ExcludedArea) -> Sequence[SubmapRow]:
    """The submaps that may reach into an area, whatever the gate says of their drives."""
    box = _grown((area.min_lon, area.min_lat, area.max_lon, area.max_lat))
    query = select(SubmapRow).join(Drive, Drive.id == SubmapRow.drive_id)
    here = (SubmapRow.map_id == area.map_id, Drive.state != "removing", SubmapRow.min_lon.is_not(None))
    rows = session.scalars(query.where(*here, indexed(session, box), maps.touches(box)))
    return sorted(rows, key=lambda row: (row.drive_id, row.position))


def show_no_more(session: Session, drive_id: str, area_ids: Iterable[str]) -> None:
    """Something of a drive that lay in these areas was dropped only now, as of a guest that got its place by the newest version:
    where that has the drive, it goes with the next one, as versions of before an area do."""
    drive, run = session.get_one(Drive, drive_id), runs.newest(session, drive_id)
    if not maps.holds(session, drive.map_id, drive_id):
        return
    if run is not None and run.created_at > maps.version(session, drive.map_id).created_at:
        return  # of a new run that no version has yet
    for area_id in area_ids:
        row = session.get(ExcludedArea, area_id)
        if row is not None:
            row.since = None


def published(session: Session, map_id: str, stitch_job_id: int) -> None:
    """A version is published: the areas that were there when this job began are not in it, and older versions that show any of them
    are withdrawn."""
    job = session.get(Job, stitch_job_id)
    new = [row for row in of_map(session, map_id) if row.since is None and row.created_at <= ((job and job.started_at) or 0.0)]
    number = maps.get(session, map_id).version
    for row in new:
        row.since = number
    boxes = [(row.min_lon, row.min_lat, row.max_lon, row.max_lat) for row in new]  # before a withdrawal has all rows read anew
    for box in boxes:  # one statement for all would be deeper than a database reads
        withdraw_versions(session, map_id, _is_shown(box))


def _grown(box: Box) -> Box:
    west, south, east, north = box
    lat = MARGIN_M / METRES_A_DEGREE
    lon = lat / max(float(np.cos(np.radians(max(abs(south), abs(north))))), 1e-3)
    return west - lon, south - lat, east + lon, north + lat


def _is_shown(box: Box) -> ColumnElement[bool]:
    """Of a version: it has a tile that touches the box."""
    west, south, east, north = _grown(box)
    touching = []
    for zoom in ZOOMS:
        low, high = (pixel_from_lonlat(np.array([corner]), zoom)[0] // TILE_PX for corner in ((west, north), (east, south)))
        first, last = int(low[0]), int(high[0])
        columns = [
            TileRow.x.between(max(first + turn, 0), last + turn) for turn in ((0, 1 << zoom, -(1 << zoom)) if zoom else (0,))
        ]
        touching.append(and_(TileRow.z == zoom, or_(*columns), TileRow.y.between(int(low[1]), int(high[1]))))
    here = (TileRow.map_id == MapVersion.map_id, of_version(TileRow, MapVersion.version))
    return exists().where(*here, or_(*touching))
