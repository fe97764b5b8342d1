"""Geometry in the database: box look-ups by an index, features of the newest version in tables, who may read them."""

import re
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import event, select, text

from service_kit import postgres, running
from service_kit.programs import needed
from wayloom.errors import ConfigError, InputError
from wayloom.stitching.marking_files import encode_features
from wayloom.store import drives, gate, map_versions, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion, RegionEntry
from wayloom.store.migrate import differences, migrations_dir, upgrade
from wayloom.store.spatial import readers
from wayloom.store.spatial.feature_tables import FEATURE_TABLES, ShownRegion
from wayloom.store.spatial.shown_features import show, show_all
from wayloom.store.spatial.wkb import wkb_as
from wayloom.store.tables.drives import SubmapRow

WIDE = 0.001
"""Degrees that a submap of these tests is wide."""
TABLE = {one.table.name: one.table for one in FEATURE_TABLES}


def feature(kind: str, geometry: str, coordinates: object, **told: object) -> dict[str, object]:
    return {
        "type": "Feature",
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": {"kind": kind, "width_m": 0.15, "covariance_m2": [1, 0, 1], **told},
    }


DASH = feature("dash", "LineString", [[8.0, 49.0, 110.0], [8.0001, 49.0, 110.5]])
ZEBRA = feature("zebra", "Polygon", [[[8.0, 49.0, 1.0], [8.1, 49.0, 1.0], [8.1, 49.1, 1.0], [8.0, 49.0, 1.0]]], bars=7)
SIGN = feature("traffic sign", "Point", [8.0, 49.0, 112.0], id="3.-4.1", drive_count=4, facing_deg=90.0)
ROAD = feature("road", "Polygon", [[[8.0, 49.0, 1.0], [8.2, 49.0, 1.0], [8.2, 49.2, 1.0], [8.0, 49.0, 1.0]]], area_m2=3.5)
KERB = feature("kerb", "MultiLineString", [[[179.9, 1.0, 2.0], [180.0, 1.0, 2.0]], [[-180.0, 1.0, 2.0], [-179.9, 1.0, 2.0]]])


def put_drive(database: Database, name: str, west: float, south: float, count: int = 1) -> str:
    """A drive of the map, its submaps in a row to the east."""
    said = Manifest(name=name, vehicle_id="car 7", files=(ManifestFile(path="log/0", size=1, sha256="0" * 64),))
    with database.write() as session:
        drive = drives.register(session, said, "city")[0]
        gate.judge(session, drive.id, "A", [], "merge")
        drive.track = [[west, south, 100.0], [west + count * WIDE, south, 101.0]]
        rows = [submap(drive.id, k, west + k * WIDE, south) for k in range(count)]
        maps.place_submaps(session, drive.id, rows)
        return drive.id


def submap(drive_id: str, position: int, west: float, south: float) -> SubmapRow:
    east, north = west + 0.9 * WIDE, south + WIDE
    return SubmapRow(
        drive_id=drive_id, map_id="city", position=position, digest=f"{position:064d}", point_count=1, frame=[8.5, 49.5, 0.0],
        T_enu_submap=[], covariance=[], track=[[west, south], [east, north]],
        min_lon=west, min_lat=south, max_lon=east, max_lat=north,
        near_min_lon=west - WIDE, near_min_lat=south - WIDE, near_max_lon=east + WIDE, near_max_lat=north + WIDE,
    )  # fmt: skip


def plan(database: Database, statement: object) -> str:
    """How the database would answer, in its words."""
    word = "EXPLAIN QUERY PLAN" if database.dialect == "sqlite" else "EXPLAIN"
    with database.read() as session:
        if database.dialect == "postgresql":
            session.execute(text("SET LOCAL enable_seqscan = off"))  # the tables of a test are too small for any index
        compiled = statement.compile(session.get_bind(), compile_kwargs={"literal_binds": True})  # type: ignore[attr-defined]
        return "\n".join(str(row) for row in session.execute(text(f"{word} {str(compiled).replace(':', chr(92) + ':')}")))


def asked(database: Database, ask: object) -> list[object]:
    """The statements that a call sends."""
    sent: list[object] = []
    with database.read() as session:
        event.listen(session, "do_orm_execute", lambda state: sent.append(state.statement))
        ask(session)  # type: ignore[operator]
    return sent


INDEX_OF = {"sqlite": ("submap_boxes", "submap_near_boxes"), "postgresql": ("ix_submaps_footprint", "ix_submaps_near_box")}


def test_submaps_are_looked_up_by_the_spatial_index(database: Database) -> None:
    first = put_drive(database, "a", 8.0, 49.0, 40)
    put_drive(database, "b", 8.01, 49.0, 5)
    by_box, by_near = INDEX_OF[database.dialect]
    (box_query,) = asked(database, lambda session: maps.submaps(session, "city", (8.0, 49.0, 8.002, 49.0005)))
    (near_query,) = asked(database, lambda session: maps.candidates_near(session, first))
    assert by_box in (found := plan(database, box_query)), found
    assert by_near in (found := plan(database, near_query)), found
    if database.dialect == "sqlite":
        assert "VIRTUAL TABLE INDEX 2:" in plan(database, box_query)  # a look-up in the tree, no walk through it


def test_the_index_finds_what_the_columns_say_wherever_submaps_lie_move_and_go(database: Database) -> None:
    ids = [put_drive(database, f"{k}", west, south, 6) for k, (west, south) in enumerate(
        [(8.0, 49.0), (8.003, 49.0004), (179.997, -16.0), (-179.9995, -16.0), (0.0, 0.0)]
    )]  # fmt: skip
    with database.write() as session:
        row = session.get_one(SubmapRow, (ids[0], 2))
        row.min_lon, row.max_lon, row.min_lat, row.max_lat = -70.0, -69.9, 10.0, 10.1
        row = session.get_one(SubmapRow, (ids[0], 3))
        row.min_lon = row.max_lon = row.min_lat = row.max_lat = None
        row = session.get_one(SubmapRow, (ids[0], 4))
        row.min_lat = row.min_lat and row.min_lat - 0.01
        maps.place_submaps(session, ids[4], [submap(ids[4], 0, 100.0, 0.0)])
    boxes = [
        (8.0, 49.0, 8.0015, 49.0), (8.0035, 48.9, 8.0035, 49.2), (-180.0, -90.0, 180.0, 90.0), (179.9985, -16.1, 180.0004, -15.9),
        (-179.9999, -16.1, -179.9992, -15.9), (-70.0, 10.0, -69.95, 10.2), (0.0, 0.0, 0.1, 0.1), (100.0, 0.0, 100.1, 0.1),
    ]  # fmt: skip
    with database.read() as session:
        for box in boxes:
            everything = select(SubmapRow).where(SubmapRow.min_lon.is_not(None), maps.touches(box))
            expected = {(row.drive_id, row.position) for row in session.scalars(everything)}
            assert {(row.drive_id, row.position) for row in maps.submaps(session, "city", box)} == expected
        found = [len(maps.submaps(session, "city", box)) for box in boxes]
    assert found == [2, 1, 24, 3, 2, 1, 0, 1]


def publish(database: Database, blobs: BlobStore, base: int, regions: dict[tuple[int, int], list[object]], **more: object) -> None:
    others = {"objects": blobs.put(encode_features([SIGN])), "areas": blobs.put(encode_features([ROAD]))}
    files = {key: blobs.put(encode_features(told)) for key, told in regions.items()}  # type: ignore[arg-type]
    entries = [RegionEntry(*key, "1" * 64, "2" * 64, [], 1, markings=digest, **others) for key, digest in files.items()]
    with database.write() as session:
        maps.ensure_map(session, "city")
        map_versions.publish(session, "city", NewVersion(base, (8.0, 49.0, 0.0), (), 0, None, [], regions=entries, **more), kept=5)  # type: ignore[arg-type]


def rows_of(database: Database, name: str) -> list[dict[str, object]]:
    with database.read() as session:
        table = TABLE[name]
        return [dict(row) for row in session.execute(select(table).order_by(table.c.east, table.c.id)).mappings()]


def test_the_tables_show_the_features_of_the_newest_version_and_of_no_other(database: Database, tmp_path: Path) -> None:
    blobs = BlobStore(tmp_path / "blobs")
    publish(database, blobs, 0, {(0, 0): [DASH, ZEBRA], (1, 0): [DASH, KERB]})
    with database.write() as session:
        assert show(session, blobs, "city") == 6
        assert show(session, blobs, "city") == 0
    (area,) = rows_of(database, "map_marking_areas")
    assert {name: area[name] for name in ("map_id", "since", "east", "north", "kind", "bars", "width_m", "period_m")} == {
        "map_id": "city", "since": 1, "east": 0, "north": 0, "kind": "zebra", "bars": 7, "width_m": 0.15, "period_m": None,
    }  # fmt: skip
    assert [row["geometry"] for row in rows_of(database, "map_markings")] == [wkb_as(DASH["geometry"], "MultiLineStringZ")] * 2  # type: ignore[arg-type]
    assert rows_of(database, "map_kerbs")[0]["geometry"] == wkb_as(KERB["geometry"], "MultiLineStringZ")  # type: ignore[arg-type]
    sign = rows_of(database, "map_objects")[0]
    told = {"kind": "traffic sign", "object_id": "3.-4.1", "drive_count": 4, "facing_deg": 90.0, "first_ns": None}
    assert {name: sign[name] for name in told} == told
    assert sign["geometry"] == wkb_as(SIGN["geometry"], "PointZ")  # type: ignore[arg-type]
    assert [row["area_m2"] for row in rows_of(database, "map_areas")] == [3.5, 3.5]
    first = rows_of(database, "map_markings")[0]
    publish(database, blobs, 1, {(1, 0): [ZEBRA]})
    show_all(database, blobs)
    assert rows_of(database, "map_markings") == [first]
    assert [(row["east"], row["since"]) for row in rows_of(database, "map_marking_areas")] == [(0, 1), (1, 2)]
    publish(database, blobs, 2, {}, dropped_regions=[(0, 0), (1, 0)])
    show_all(database, blobs)
    assert [rows_of(database, name) for name in TABLE] == [[]] * len(TABLE)
    with database.read() as session:
        assert session.scalars(select(ShownRegion)).all() == []


def test_tables_that_a_migration_emptied_fill_again(database: Database, tmp_path: Path) -> None:
    blobs = BlobStore(tmp_path / "blobs")
    publish(database, blobs, 0, {(0, 0): [DASH]})
    show_all(database, blobs)
    with database.write() as session:
        session.execute(TABLE["map_markings"].delete())
        session.execute(ShownRegion.__table__.delete())  # type: ignore[attr-defined]
    show_all(database, blobs)
    assert len(rows_of(database, "map_markings")) == 1


@pytest.mark.parametrize(("geometry", "kind"), [("Point", "LineString"), ("MultiLineString", "LineStringZ")])
def test_a_geometry_of_another_kind_is_refused(geometry: str, kind: str) -> None:
    with pytest.raises(ValueError, match="is no LineString"):
        wkb_as({"type": geometry, "coordinates": []}, kind)


def test_a_lost_trigger_or_index_is_told_by_the_check(empty_database: Database) -> None:
    upgrade(empty_database)
    gone = "TRIGGER submap_boxes_update" if empty_database.dialect == "sqlite" else "INDEX ix_submaps_near_box"
    with empty_database.write() as session:
        session.execute(text(f"DROP {gone}"))
    assert differences(empty_database) == [("missing", gone.split()[1])]


ON_POSTGRES = pytest.mark.parametrize("database", [pytest.param("postgresql", marks=pytest.mark.postgres)], indirect=True)


@pytest.fixture
def mapped(database: Database, tmp_path: Path) -> Database:
    """A map with two drives, one across the antimeridian, and features."""
    put_drive(database, "a", 8.0, 49.0, 3)
    other = put_drive(database, "b", 179.9995, -16.0, 3)
    with database.write() as session:
        drives.get(session, other).track = [[179.9995, -16.0, 9.0], [-179.9995, -16.0, 11.0]]
    publish(database, BlobStore(tmp_path / "blobs"), 0, {(0, 0): [DASH, ZEBRA, KERB]})
    show_all(database, BlobStore(tmp_path / "blobs"))
    return database


@ON_POSTGRES
def test_a_track_is_cut_at_the_antimeridian_and_one_place_is_no_line(mapped: Database) -> None:
    with mapped.write() as session:
        lines = dict(map(tuple, session.execute(text("SELECT name, ST_AsText(geometry) FROM drive_tracks"))))
        assert lines["b"] == "MULTILINESTRING Z ((179.9995 -16 9,180 -16 10),(-180 -16 10,-179.9995 -16 11))"
        session.execute(text("UPDATE drives SET track = '[[8, 49, 1]]' WHERE name = 'a'"))
        assert session.scalars(text("SELECT name FROM drive_tracks")).all() == ["b"]


@ON_POSTGRES
def test_the_views_own_word_on_who_is_in_the_map_is_that_of_the_queries(database: Database) -> None:
    """Every way in which a drive may stand to the map."""
    ids = [put_drive(database, f"{k}", 8.0, 49.0) for k in range(16)]
    with database.write() as session:
        for k, drive_id in enumerate(ids):
            row = drives.get(session, drive_id)
            row.gate = ("merge", "hold", "quarantine", None)[k % 4]
            row.sound, row.admitted = (None if k % 8 == 7 else k < 8), k % 2 == 1 or k < 2
            row.released_at = 5.0 if k in (2, 5, 11) else None
            row.state = "removing" if k == 4 else "done"
        session.flush()
        told = set(session.scalars(text("SELECT id FROM drive_tracks WHERE in_map")))
        assert told == {row.drive_id for row in maps.submaps(session, "city")}
        assert len(told) > 3
        assert not session.scalar(text("SELECT count(*) FROM drive_tracks WHERE in_map IS NULL"))


def ogrinfo(database: Database, *arguments: str, user: str = "wayloom") -> str:
    """What GDAL says of the database. Missing is a failure in CI and a skip elsewhere, as for the server."""
    needed("ogrinfo", "gdal-bin")
    url = database.engine.url
    source = f"PG:host={url.query['host']} dbname={url.database} user={user}"
    done = subprocess.run(["ogrinfo", "-ro", source, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def reader(mapped: Database) -> Iterator[str]:
    """A role that was let read by the command."""
    name = f"reader_{uuid.uuid4().hex}"
    with mapped.write() as session:
        session.execute(text(f"CREATE ROLE {name} LOGIN"))
    environment = running.environment(WAYLOOM_DATABASE_URL=mapped.url)
    command = [sys.executable, "-m", "wayloom.store", "grant-readonly", name]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    yield name
    with mapped.write() as session:
        session.execute(text(f"DROP OWNED BY {name}"))
        session.execute(text(f"DROP ROLE {name}"))


@ON_POSTGRES
def test_gdal_lists_the_geometries_with_type_reference_system_and_extent(mapped: Database, reader: str) -> None:
    listed = ogrinfo(mapped, user=reader)
    layers = {
        "drive_tracks": ["3D Multi Line String"], "submaps": ["Multi Polygon", "Multi Line String"],
        "map_objects": ["3D Point"], "map_areas": ["3D Polygon"],
        "map_markings": ["3D Multi Line String"], "map_marking_areas": ["3D Polygon"], "map_kerbs": ["3D Multi Line String"],
    }  # fmt: skip
    extents = {
        "map_markings": "Extent: (8.000000, 49.000000) - (8.000100, 49.000000)",
        "submaps": "Extent (footprint): (-180.000000, -16.000000) - (180.000000, 49.001000)",
    }
    for layer, kinds in layers.items():
        assert f"{layer} ({', '.join(kinds)})" in listed
        said = ogrinfo(mapped, "-so", layer, user=reader)
        for kind in kinds:
            assert re.search(rf"Geometry( \(\w+\))?: {kind}", said)
        assert said.count('ID["EPSG",4326]]\n') == len(kinds)
        assert extents.get(layer, "Extent: (") in said
    assert "FID Column = id" in ogrinfo(mapped, "-so", "map_markings", user=reader)


@ON_POSTGRES
def test_every_readable_table_has_what_qgis_asks_for(mapped: Database) -> None:
    """An entry among the geometry columns, a primary key (a view: a column that is one), an index of the geometry."""
    with mapped.read() as session:
        entries = {
            tuple(row) for row in session.execute(text("SELECT f_table_name, f_geometry_column, srid FROM geometry_columns"))
        }
        keys = set(session.scalars(text("SELECT conrelid::regclass::text FROM pg_constraint WHERE contype = 'p'")))
        indices = session.scalars(text("SELECT indexdef FROM pg_indexes WHERE indexdef LIKE '%USING gist%'")).all()
        assert len(set(session.scalars(text("SELECT id FROM drive_tracks")))) == session.scalar(
            text("SELECT count(*) FROM drive_tracks")
        )
    columns = {name: {"geometry"} for name in readers.READABLE} | {"submaps": {"footprint", "track_line"}}
    for name in readers.READABLE:
        assert {(name, column, 4326) for column in columns[name]} <= entries
        if name != "drive_tracks":
            assert name in keys
            assert all(any(f".{name} " in one and f"({column})" in one for one in indices) for column in columns[name])


@ON_POSTGRES
def test_a_reader_sees_the_geometry_and_nothing_else_and_writes_nothing(mapped: Database, reader: str) -> None:
    url = mapped.engine.url
    with psycopg.connect(f"host={url.query['host']} dbname={url.database} user={reader}", autocommit=True) as connection:
        for name in readers.READABLE:
            (count,) = connection.execute(f"SELECT count(*) FROM {name}").fetchone() or (0,)
            assert count > 0
        with mapped.read() as session:
            tables = set(session.scalars(text("SELECT tablename FROM pg_tables WHERE schemaname = 'public'")))
        assert {"jobs", "uploads", "drives", "drive_files", "rigs"} <= tables
        for name in sorted(tables - {*readers.READABLE, "spatial_ref_sys"}):
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                connection.execute(f'SELECT 1 FROM "{name}"')
        assert connection.execute("SHOW default_transaction_read_only").fetchone() == ("on",)
        connection.execute("SET default_transaction_read_only = off")
        for change in ("UPDATE submaps SET point_count = 0", "DELETE FROM map_kerbs", "INSERT INTO jobs DEFAULT VALUES",
                       "UPDATE drive_tracks SET name = 'mine'", "CREATE TABLE mine (x int)"):  # fmt: skip
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                connection.execute(change)


@ON_POSTGRES
def test_tables_that_come_with_a_migration_are_granted_to_the_readers_of_the_others(mapped: Database, reader: str) -> None:
    with mapped.write() as session:
        session.execute(text(f"REVOKE SELECT ON map_kerbs FROM {reader}"))
    upgrade(mapped)
    with mapped.read() as session:
        assert session.scalar(text("SELECT has_table_privilege(:role, 'map_kerbs', 'SELECT')"), {"role": reader})


@ON_POSTGRES
def test_a_role_that_is_none_or_may_do_all_already_is_refused(database: Database) -> None:
    with pytest.raises(InputError, match="there is no such role"):
        readers.grant_readonly(database, "nobody; DROP TABLE jobs")
    with pytest.raises(InputError, match="already"):
        readers.grant_readonly(database, "wayloom")


def test_sqlite_has_no_roles(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no roles"):
        readers.grant_readonly(Database(f"sqlite:///{tmp_path / 'wayloom.db'}"), "qgis")


@pytest.mark.postgres
def test_the_migration_makes_postgis_and_fills_the_geometry_of_rows_that_are_there(postgres_folder: str) -> None:
    name = f"t{uuid.uuid4().hex}"
    with psycopg.connect(f"host={postgres_folder} user=wayloom dbname=postgres", autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE template0")
    database = Database(postgres.url(postgres_folder, name))
    migrate_to(database, "0013")
    put_old_rows(database)
    upgrade(database)
    with database.read() as session:
        assert session.scalars(text("SELECT ST_AsText(geometry) FROM drive_tracks")).all() == [
            "MULTILINESTRING Z ((8 49 100,8.1 49 101))"
        ]
        assert session.scalars(text("SELECT ST_AsText(footprint) FROM submaps")).all() == [
            "MULTIPOLYGON(((8 49,8 50,9 50,9 49,8 49)))"
        ]
    database.close()


def test_the_migration_fills_the_tree_of_rows_that_are_there(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'old.db'}")
    migrate_to(database, "0013")
    put_old_rows(database)
    upgrade(database)
    with database.read() as session:
        assert session.execute(text("SELECT drive_id, position, min_lon, max_lat FROM submap_boxes")).all() == [
            ("d" * 64, 0, 8.0, 50.0)
        ]
    database.close()


def migrate_to(database: Database, revision: str) -> None:
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
        connection.commit()


def put_old_rows(database: Database) -> None:
    """A drive and its submap, as a database of before has them."""
    with database.write() as session:
        session.execute(text("INSERT INTO maps (id, version, created_at) VALUES ('city', 0, 0)"))
        session.execute(
            text("INSERT INTO drives (id, name, map_id, manifest, file_count, byte_count, state, facts, track, created_at) "
                 "VALUES (:id, 'old', 'city', '{}', 0, 0, 'done', '{}', :track, 0)"),
            {"id": "d" * 64, "track": "[[8, 49, 100], [8.1, 49, 101]]"},
        )  # fmt: skip
        session.execute(
            text("INSERT INTO submaps (drive_id, position, map_id, digest, point_count, frame, \"T_enu_submap\", covariance, "
                 "min_lon, min_lat, max_lon, max_lat) VALUES (:id, 0, 'city', :id, 1, '[]', '[]', '[]', 8, 49, 9, 50)"),
            {"id": "d" * 64},
        )  # fmt: skip
