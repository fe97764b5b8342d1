"""Geometry of drives and submaps, spatial indices of their boxes, and tables of the newest versions' features.

PostgreSQL generates the geometry from the columns that are there, of rows that exist too; SQLite's triggers keep R*Trees. The
tables of features fill from the regions' files when the migration is over (`wayloom.store.spatial.shown_features`).
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.exc import DBAPIError

from wayloom.errors import InputError

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

INTEGER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
BOX = "ix_submaps_box", ["map_id", "min_lon", "max_lon", "min_lat", "max_lat"]
NEAR = "ix_submaps_near", ["map_id", "near_min_lon", "near_max_lon", "near_min_lat", "near_max_lat"]
OBJECT = ("height_m", "bottom_m", "width_m", "facing_deg", "facing_sigma_deg", "sigma_m", "confidence")
AREA = ("area_m2", "confidence", "sigma_place_m")
PAINT = ("width_m", "length_m", "sigma_m", "sigma_place_m", "confidence")
KERB = ("length_m", "height_m", "sigma_m", "sigma_height_m", "sigma_place_m", "confidence")
FUNCTIONS = (
    # a box of degrees as polygons; west below -180 or east above 180: in two, on both sides of the antimeridian
    """
    CREATE FUNCTION wayloom_box(west float8, south float8, east float8, north float8) RETURNS geometry
    LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
    RETURN ST_Multi(CASE
        WHEN east > 180 THEN ST_CollectionExtract(ST_WrapX(ST_MakeEnvelope(west, south, east, north, 4326), 180, -360), 3)
        WHEN west < -180 THEN ST_CollectionExtract(ST_WrapX(ST_MakeEnvelope(west, south, east, north, 4326), -180, 360), 3)
        ELSE ST_MakeEnvelope(west, south, east, north, 4326) END)
    """,
    # a list of places as a line; none of less than two
    """
    CREATE FUNCTION wayloom_line(places json) RETURNS geometry LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
    RETURN CASE WHEN json_typeof(places) = 'array' THEN CASE WHEN json_array_length(places) > 1 THEN
        ST_GeomFromGeoJSON('{"type":"LineString","coordinates":' || places::text || '}') END END
    """,
    # the same, cut at the antimeridian
    """
    CREATE FUNCTION wayloom_track(places json) RETURNS geometry LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
    RETURN CASE WHEN ST_XMax(wayloom_line(places)) - ST_XMin(wayloom_line(places)) > 180
        THEN ST_CollectionExtract(ST_WrapX(ST_ShiftLongitude(wayloom_line(places)), 180, -360), 2)
        ELSE ST_Multi(wayloom_line(places)) END
    """,
)
NAMES = ("wayloom_box(float8, float8, float8, float8)", "wayloom_line(json)", "wayloom_track(json)")
COLUMNS = (
    ("drives", "track_line", "MultiLineStringZ", "ST_Force3D(wayloom_track(track))"),
    ("submaps", "footprint", "MultiPolygon", "wayloom_box(min_lon, min_lat, max_lon, max_lat)"),
    ("submaps", "track_line", "MultiLineString", "ST_Force2D(wayloom_track(track))"),
)
NEAR_BOX = "wayloom_box(near_min_lon, near_min_lat, near_max_lon, near_max_lat)"
DRIVE_TRACKS = """
    CREATE VIEW drive_tracks AS SELECT id, map_id, name, vehicle_id, state, grade, gate,
        coalesce(state <> 'removing' AND (gate = 'merge' OR released_at IS NOT NULL OR (gate = 'hold' AND sound AND admitted)),
            false) AS in_map,
        to_timestamp(created_at) AS created_at, to_timestamp(finished_at) AS finished_at, track_line AS geometry
    FROM drives WHERE track_line IS NOT NULL
"""
TREES = {"submap_boxes": "", "submap_near_boxes": "near_"}


def upgrade() -> None:
    """Forward."""
    for name, _ in (BOX, NEAR):
        op.drop_index(name, "submaps")
    if op.get_bind().dialect.name == "postgresql":
        _use_postgis()
        _geometry_of_rows()
    else:
        for tree, prefix in TREES.items():
            _grow(tree, prefix)
    _feature_tables()


def _use_postgis() -> None:
    connection = op.get_bind()
    if connection.scalar(sa.text("SELECT 1 FROM pg_extension WHERE extname = 'postgis'")):
        return
    try:
        with connection.begin_nested():
            op.execute("CREATE EXTENSION postgis")
    except DBAPIError as error:
        said = str(error.orig).splitlines()[0]
        remedy = "install PostGIS on its server, and have an administrator run CREATE EXTENSION postgis in it"
        raise InputError(f"it has no PostGIS ({said})", file="the database", remedy=remedy) from None


def _geometry_of_rows() -> None:
    for function in FUNCTIONS:
        op.execute(function)
    for table, column, kind, expression in COLUMNS:
        op.execute(f"ALTER TABLE {table} ADD COLUMN {column} geometry({kind},4326) GENERATED ALWAYS AS ({expression}) STORED")
        op.execute(f"CREATE INDEX ix_{table}_{column} ON {table} USING gist ({column})")
    op.execute(f"CREATE INDEX ix_submaps_near_box ON submaps USING gist ({NEAR_BOX})")
    op.execute(DRIVE_TRACKS)


def _grow(tree: str, prefix: str) -> None:
    """An R*Tree of a submap's box and the triggers that keep it. An entry that goes is found by its box: nothing else is a key."""
    west, east, south, north = sides = [f"{prefix}{side}" for side in ("min_lon", "max_lon", "min_lat", "max_lat")]
    names = "min_lon, max_lon, min_lat, max_lat"
    op.execute(f"CREATE VIRTUAL TABLE {tree} USING rtree(id, {names}, +drive_id TEXT, +position INTEGER)")
    into = f"INSERT INTO {tree} ({names}, drive_id, position)"
    new = ", ".join(f"NEW.{side}" for side in sides)
    plant = f"{into} SELECT {new}, NEW.drive_id, NEW.position WHERE NEW.{west} IS NOT NULL;"
    near = f"min_lon <= OLD.{west} AND max_lon >= OLD.{east} AND min_lat <= OLD.{south} AND max_lat >= OLD.{north}"
    fell = f"DELETE FROM {tree} WHERE {near} AND drive_id = OLD.drive_id AND position = OLD.position;"  # noqa: S608
    changed = ", ".join(["drive_id", "position", *sides])
    op.execute(f"CREATE TRIGGER {tree}_insert AFTER INSERT ON submaps BEGIN {plant} END")
    op.execute(f"CREATE TRIGGER {tree}_update AFTER UPDATE OF {changed} ON submaps BEGIN {fell} {plant} END")
    op.execute(f"CREATE TRIGGER {tree}_delete AFTER DELETE ON submaps BEGIN {fell} END")
    op.execute(f"{into} SELECT {', '.join(sides)}, drive_id, position FROM submaps WHERE {west} IS NOT NULL")  # noqa: S608


def _feature_tables() -> None:
    op.create_table(
        "shown_regions",
        sa.Column("map_id", sa.String(63), nullable=False),
        sa.Column("source", sa.String(32), nullable=False),
        sa.Column("east", INTEGER, nullable=False),
        sa.Column("north", INTEGER, nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("map_id", "source", "east", "north", name=op.f("pk_shown_regions")),
    )
    _feature_table("map_objects", "PointZ", *_columns(("object_id", "kind"), OBJECT, ("drive_count", "first_ns", "last_ns")))
    _feature_table("map_areas", "PolygonZ", *_columns(("kind",), AREA))
    _feature_table("map_markings", "MultiLineStringZ", *_columns(("kind",), PAINT))
    _feature_table("map_marking_areas", "PolygonZ", *_columns(("kind",), (*PAINT, "period_m"), ("bars",)))
    _feature_table("map_kerbs", "MultiLineStringZ", *_columns((), KERB))


def _columns(text: tuple[str, ...], numbers: tuple[str, ...], whole: tuple[str, ...] = ()) -> list[sa.Column[object]]:
    kinds = ((text, sa.Text()), (numbers, sa.Float(53)), (whole, INTEGER))
    return [sa.Column(name, kind) for names, kind in kinds for name in names]


def _feature_table(name: str, kind: str, *fields: sa.Column[object]) -> None:
    on_postgres = op.get_bind().dialect.name == "postgresql"
    op.create_table(
        name,
        sa.Column("id", INTEGER, autoincrement=True, nullable=False),
        sa.Column("map_id", sa.String(63), nullable=False),
        sa.Column("since", INTEGER, nullable=False),
        sa.Column("east", INTEGER, nullable=False),
        sa.Column("north", INTEGER, nullable=False),
        *fields,
        *(() if on_postgres else (sa.Column("geometry", sa.LargeBinary(), nullable=False),)),
        sa.PrimaryKeyConstraint("id", name=op.f(f"pk_{name}")),
    )
    if on_postgres:
        op.execute(f"ALTER TABLE {name} ADD COLUMN geometry geometry({kind},4326) NOT NULL")
        op.execute(f"CREATE INDEX ix_{name}_geometry ON {name} USING gist (geometry)")
    op.create_index(f"ix_{name}_map_id_east_north", name, ["map_id", "east", "north"])


def downgrade() -> None:
    """Back."""
    for name in ("map_kerbs", "map_marking_areas", "map_markings", "map_areas", "map_objects", "shown_regions"):
        op.drop_table(name)
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP VIEW drive_tracks")
        op.execute("DROP INDEX ix_submaps_near_box")
        for table, column, _, _ in COLUMNS:
            op.execute(f"ALTER TABLE {table} DROP COLUMN {column}")
        for function in reversed(NAMES):
            op.execute(f"DROP FUNCTION {function}")
    else:
        for tree in TREES:
            for event in ("insert", "update", "delete"):
                op.execute(f"DROP TRIGGER {tree}_{event}")
            op.execute(f"DROP TABLE {tree}")
    for name, columns in (BOX, NEAR):
        op.create_index(name, "submaps", columns)
