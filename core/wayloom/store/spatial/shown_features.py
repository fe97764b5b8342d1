"""Features of the newest version of a map, written to the tables that GIS programs read."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

from sqlalchemy import delete, insert, select
from sqlalchemy.orm import Session

from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.spatial.feature_tables import FEATURE_TABLES, PROPERTY_OF, FeatureTable, ShownRegion
from wayloom.store.spatial.wkb import wkb_as
from wayloom.store.tables.maps import Map, RegionRow

RegionKey = tuple[int, int]
ROWS: Final = 1000
"""Written by one statement."""


def show_all(database: Database, blobs: BlobStore) -> None:
    """Have the tables show every map's newest version: after a migration that made or emptied them."""
    with database.read() as session:
        found = session.scalars(select(Map.id).where(Map.version > 0).order_by(Map.id)).all()
    for map_id in found:
        with database.write() as session:
            show(session, blobs, map_id)


def show(session: Session, blobs: BlobStore, map_id: str) -> int:
    """Have the tables show the map's newest version; what has not changed stays. Returns how many regions were written anew or
    went. Raises NotFoundError where a region's file is not in the store."""
    version, count = session.get_one(Map, map_id).version, 0
    for source in dict.fromkeys(table.source for table in FEATURE_TABLES):
        wanted, shown = _newest(session, map_id, source), _shown(session, map_id, source)
        for key in sorted(shown.keys() | wanted.keys()):
            if shown.get(key) != wanted.get(key):
                if key in shown:
                    _forget(session, map_id, source, key)
                if key in wanted:
                    region = ShownRegion(map_id=map_id, source=source, east=key[0], north=key[1], digest=wanted[key])
                    _write(session, blobs, region, version)
                count += 1
    return count


def _newest(session: Session, map_id: str, source: str) -> dict[RegionKey, str]:
    """The regions of the newest version that have a file, with its digest."""
    digest = getattr(RegionRow, source)
    here = (RegionRow.map_id == map_id, RegionRow.until.is_(None), digest != "")
    return {
        (east, north): found for east, north, found in session.execute(select(RegionRow.east, RegionRow.north, digest).where(*here))
    }


def _shown(session: Session, map_id: str, source: str) -> dict[RegionKey, str]:
    here = (ShownRegion.map_id == map_id, ShownRegion.source == source)
    rows = session.execute(select(ShownRegion.east, ShownRegion.north, ShownRegion.digest).where(*here))
    return {(east, north): digest for east, north, digest in rows}


def _forget(session: Session, map_id: str, source: str, key: RegionKey) -> None:
    for one in FEATURE_TABLES:
        if one.source == source:
            at = one.table.c
            session.execute(delete(one.table).where(at.map_id == map_id, at.east == key[0], at.north == key[1]))
    here = (ShownRegion.map_id == map_id, ShownRegion.source == source, ShownRegion.east == key[0], ShownRegion.north == key[1])
    session.execute(delete(ShownRegion).where(*here))


def _write(session: Session, blobs: BlobStore, region: ShownRegion, version: int) -> None:
    features = json.loads(blobs.get(region.digest))["features"]
    common = {"map_id": region.map_id, "since": version, "east": region.east, "north": region.north}
    for one in FEATURE_TABLES:
        if one.source == region.source:
            rows = [common | row for row in _rows(one, features)]
            for start in range(0, len(rows), ROWS):
                session.execute(insert(one.table), rows[start : start + ROWS])
    session.add(region)
    session.flush()


def _rows(one: FeatureTable, features: list[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    for feature in features:
        if one.takes(feature):
            told = {field: feature["properties"].get(PROPERTY_OF.get(field, field)) for field in one.fields}
            yield {**told, "geometry": wkb_as(feature["geometry"], one.kind)}
