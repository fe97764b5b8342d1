"""OGC GeoPackage 1.3 of a map's features: one table a collection, R-trees, provenance in the metadata tables."""

import errno
import itertools
import json
import sqlite3
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from sqlite3 import connect
from typing import Any, Final

from wayloom.config.progress import Progress, silent
from wayloom.exports.features import Collection, places_of, read_collection, single_parts, wanted_collections
from wayloom.exports.source import Feature, MapSource
from wayloom.exports.wkb import wkb
from wayloom.files.atomic import replacing_by_name
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box

APPLICATION_ID: Final = 0x47504B47
"""GPKG."""
USER_VERSION: Final = 10300
WGS84: Final = 4326
MANDATORY, OPTIONAL = 1, 2
"""Heights; GDAL has no type for geometries of any kind that all have them."""
BATCH: Final = 1000
SQL_TYPES: Final = {"text": "TEXT", "real": "REAL", "whole": "INTEGER", "json": "TEXT"}
TABLES: Final = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')), min_x DOUBLE,
  min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL UNIQUE REFERENCES gpkg_contents(table_name), column_name TEXT NOT NULL,
  geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys(srs_id), z TINYINT NOT NULL,
  m TINYINT NOT NULL, PRIMARY KEY (table_name, column_name));
CREATE TABLE gpkg_extensions (table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, definition TEXT NOT NULL,
  scope TEXT NOT NULL, UNIQUE (table_name, column_name, extension_name));
CREATE TABLE gpkg_metadata (id INTEGER PRIMARY KEY NOT NULL, md_scope TEXT NOT NULL DEFAULT 'dataset',
  md_standard_uri TEXT NOT NULL, mime_type TEXT NOT NULL DEFAULT 'text/xml', metadata TEXT NOT NULL DEFAULT '');
CREATE TABLE gpkg_metadata_reference (reference_scope TEXT NOT NULL, table_name TEXT, column_name TEXT, row_id_value INTEGER,
  timestamp DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  md_file_id INTEGER NOT NULL REFERENCES gpkg_metadata(id), md_parent_id INTEGER REFERENCES gpkg_metadata(id));
"""
METADATA_URI: Final = "http://www.geopackage.org/spec130/#extension_metadata"
RTREE_URI: Final = "http://www.geopackage.org/spec130/#extension_rtree"
PROVENANCE_URI: Final = "https://github.com/wayloom/wayloom/provenance"
Row = tuple[Any, ...]


def write_geopackage(
    path: Path, source: MapSource, box: Box | None, names: Sequence[str], provenance: Mapping[str, Any], progress: Progress = silent
) -> dict[str, int]:
    """Write the collections of these names, all for none; how many features each has. Raises InputError, OSError."""
    wanted = wanted_collections(names)
    with replacing_by_name(path) as file:
        try:
            with closing(connect(file, isolation_level=None)) as db:
                _prepare(db, provenance)
                counts = {
                    name: _write_table(db, name, one, read_collection(name, source, box, progress)) for name, one in wanted.items()
                }
                db.execute("COMMIT")
        except sqlite3.OperationalError as problem:
            raise OSError(_errno(problem), str(problem), str(path)) from problem
    return counts


def _errno(problem: sqlite3.OperationalError) -> int:
    return errno.ENOSPC if problem.sqlite_errorcode == sqlite3.SQLITE_FULL else errno.EIO


def _prepare(db: sqlite3.Connection, provenance: Mapping[str, Any]) -> None:
    for pragma in (f"application_id={APPLICATION_ID}", f"user_version={USER_VERSION}", "journal_mode=OFF", "synchronous=OFF"):
        db.execute(f"PRAGMA {pragma}")
    db.execute("BEGIN")
    for statement in filter(str.strip, TABLES.split(";")):
        db.execute(statement)
    systems = [
        ("WGS 84", WGS84, "EPSG", WGS84, wgs84.wkt(WGS84), "longitude, latitude; heights are ellipsoidal"),
        ("Undefined Cartesian", -1, "NONE", -1, "undefined", None),
        ("Undefined geographic", 0, "NONE", 0, "undefined", None),
    ]
    db.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", systems)
    metadata = (1, "dataset", PROVENANCE_URI, "application/json", json.dumps(provenance))
    db.execute("INSERT INTO gpkg_metadata VALUES (?, ?, ?, ?, ?)", metadata)
    db.execute("INSERT INTO gpkg_metadata_reference (reference_scope, md_file_id) VALUES ('geopackage', 1)")
    for table in ("gpkg_metadata", "gpkg_metadata_reference"):
        db.execute("INSERT INTO gpkg_extensions VALUES (?, NULL, 'gpkg_metadata', ?, 'read-write')", (table, METADATA_URI))


def _write_table(db: sqlite3.Connection, name: str, collection: Collection, features: Iterable[Feature]) -> int:
    """Make the table of a collection and its R-tree, and fill both; how many rows."""
    columns = "".join(f', "{column}" {SQL_TYPES[kind]}' for column, kind in collection.columns.items())
    db.execute(f'CREATE TABLE "{name}" (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom GEOMETRY{columns})')
    db.execute(f'CREATE VIRTUAL TABLE "rtree_{name}_geom" USING rtree(id, minx, maxx, miny, maxy)')
    marks = ", ".join("?" * (2 + len(collection.columns)))
    bounds: tuple[float, float, float, float] | None = None
    single = features if collection.geometry == "Geometry" else single_parts(features)
    numbered, count = enumerate(single, 1), 0
    while rows := [_row(fid, feature, collection) for fid, feature in itertools.islice(numbered, BATCH)]:
        db.executemany(f'INSERT INTO "{name}" VALUES ({marks})', [row for row, _ in rows])  # noqa: S608 (names of our own)
        boxes = [(row[0], *box) for row, box in rows]
        db.executemany(f'INSERT INTO "rtree_{name}_geom" VALUES (?, ?, ?, ?, ?)', boxes)  # noqa: S608
        wests, easts, souths, norths = zip(*(box for _, box in rows), strict=True)
        west, south, east, north = min(wests), min(souths), max(easts), max(norths)
        w, s, e, n = bounds or (west, south, east, north)
        bounds = (min(w, west), min(s, south), max(e, east), max(n, north))
        count += len(rows)
    contents = (name, "features", name, collection.about, *(bounds or (None,) * 4), WGS84)
    db.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, min_x, min_y, max_x, max_y, srs_id) "
        "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        contents,
    )
    z = OPTIONAL if collection.geometry == "Geometry" else MANDATORY
    geometry = (name, collection.geometry.upper(), WGS84, z)
    db.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, ?, 0)", geometry)
    db.execute("INSERT INTO gpkg_extensions VALUES (?, 'geom', 'gpkg_rtree_index', ?, 'write-only')", (name, RTREE_URI))
    for trigger in _triggers(name):
        db.execute(trigger)
    return count


def _row(fid: int, feature: Feature, collection: Collection) -> tuple[Row, tuple[float, float, float, float]]:
    """A row of the table, and the box of its R-tree: least and greatest x, then y."""
    lon, lat = zip(*(place[:2] for place in places_of(feature["geometry"])), strict=True)
    box = (min(lon), max(lon), min(lat), max(lat))
    header = struct.pack("<2sBBi4d", b"GP", 0, 0b011, WGS84, *box)
    told = (_value(feature["properties"].get(column), kind) for column, kind in collection.columns.items())
    return (fid, header + wkb(feature["geometry"]), *told), box


def _value(value: Any, kind: str) -> Any:
    return json.dumps(value) if kind == "json" and value is not None else value


def _triggers(name: str) -> Iterator[str]:
    """What keeps the R-tree up to date when an editor changes the table: the standard's triggers of the extension."""
    tree, box = f'"rtree_{name}_geom"', "ST_MinX(NEW.geom), ST_MaxX(NEW.geom), ST_MinY(NEW.geom), ST_MaxY(NEW.geom)"
    put = f"INSERT OR REPLACE INTO {tree} VALUES (NEW.fid, {box});"  # noqa: S608 (names of our own)
    some, none = "NEW.geom NOT NULL AND NOT ST_IsEmpty(NEW.geom)", "(NEW.geom IS NULL OR ST_IsEmpty(NEW.geom))"
    drop = f"DELETE FROM {tree} WHERE id = OLD.fid;"  # noqa: S608
    cases = (
        ("insert", "AFTER INSERT", some, put),
        ("update1", "AFTER UPDATE OF geom", f"OLD.fid = NEW.fid AND ({some})", put),
        ("update2", "AFTER UPDATE OF geom", f"OLD.fid = NEW.fid AND {none}", drop),
        ("update3", "AFTER UPDATE", f"OLD.fid != NEW.fid AND ({some})", drop + put),
        ("update4", "AFTER UPDATE", f"OLD.fid != NEW.fid AND {none}", f"DELETE FROM {tree} WHERE id IN (OLD.fid, NEW.fid);"),  # noqa: S608
        ("delete", "AFTER DELETE", "OLD.geom NOT NULL", drop),
    )  # fmt: skip
    for event, when, condition, action in cases:
        yield f'CREATE TRIGGER "rtree_{name}_geom_{event}" {when} ON "{name}" WHEN ({condition}) BEGIN {action} END'
