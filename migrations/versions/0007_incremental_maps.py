"""Share tiles between versions of a map, keep its regions, and remember where it has changed.

The newest version of every map is kept, the older ones are forgotten.
"""

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

INTEGER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
OLDER_TILES = "DELETE FROM tiles WHERE version <> (SELECT m.version FROM maps AS m WHERE m.id = map_id)"
OLDER_VERSIONS = "DELETE FROM map_versions WHERE version <> (SELECT m.version FROM maps AS m WHERE m.id = map_id)"
COPY_TILES = """
    INSERT INTO tiles (map_id, layer, z, x, y, digest, media_type, size, since)
    SELECT map_id, layer, z, x, y, digest, media_type, size, version FROM old_tiles
"""


def _span() -> tuple[sa.Column[int], sa.Column[int]]:
    return sa.Column("since", INTEGER, nullable=False), sa.Column("until", INTEGER, nullable=True)


def _index_ended(table: str) -> None:
    ended = sa.text("until IS NOT NULL")
    op.create_index(f"ix_{table}_until", table, ["map_id", "until"], sqlite_where=ended, postgresql_where=ended)


def upgrade() -> None:
    """Forward."""
    op.execute(OLDER_TILES)
    op.execute(OLDER_VERSIONS)
    drives = _drives_of_maps()
    _tiles_by_span()
    op.create_table(
        "regions",
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("east", INTEGER, nullable=False),
        sa.Column("north", INTEGER, nullable=False),
        *_span(),
        sa.Column("inputs", sa.String(length=64), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("members", sa.JSON(), nullable=False),
        sa.Column("size", INTEGER, nullable=False),
        sa.PrimaryKeyConstraint("map_id", "east", "north", "since", name=op.f("pk_regions")),
    )
    _index_ended("regions")
    op.create_table(
        "map_drives",
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        *_span(),
        sa.PrimaryKeyConstraint("map_id", "drive_id", "since", name=op.f("pk_map_drives")),
    )
    _index_ended("map_drives")
    op.create_table(
        "changed_boxes",
        sa.Column("id", INTEGER, autoincrement=True, nullable=False),
        sa.Column("map_id", sa.String(length=63), nullable=False),
        *(sa.Column(name, sa.Float(precision=53), nullable=False) for name in ("min_lon", "min_lat", "max_lon", "max_lat")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_changed_boxes_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_changed_boxes")),
    )
    op.create_index("ix_changed_boxes_map_id", "changed_boxes", ["map_id"])
    with op.batch_alter_table("submaps") as submaps:
        submaps.add_column(sa.Column("track", sa.JSON(), nullable=False, server_default="[]"))
        submaps.add_column(sa.Column("track_t_ns", INTEGER, nullable=False, server_default="0"))
    with op.batch_alter_table("map_versions") as versions:
        versions.add_column(sa.Column("built_with", sa.String(length=64), nullable=False, server_default=""))
        versions.add_column(sa.Column("drive_count", INTEGER, nullable=False, server_default="0"))
        versions.drop_column("drives")
    _write_drives(drives)


def _drives_of_maps() -> list[dict[str, Any]]:
    rows = op.get_bind().execute(sa.text("SELECT map_id, version, drives FROM map_versions")).all()
    lists = [(map_id, version, json.loads(found) if isinstance(found, str) else found) for map_id, version, found in rows]
    return [
        {"map_id": map_id, "drive_id": drive_id, "since": version} for map_id, version, ids in lists for drive_id in sorted({*ids})
    ]


def _write_drives(drives: list[dict[str, Any]]) -> None:
    if drives:
        op.get_bind().execute(
            sa.text("INSERT INTO map_drives (map_id, drive_id, since) VALUES (:map_id, :drive_id, :since)"), drives
        )
    op.execute("UPDATE map_versions SET drive_count = (SELECT count(*) FROM map_drives AS d WHERE d.map_id = map_versions.map_id)")


def _tiles_by_span() -> None:
    op.rename_table("tiles", "old_tiles")
    op.create_table(
        "tiles",
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("layer", sa.String(length=32), nullable=False),
        *(sa.Column(name, INTEGER, nullable=False) for name in ("z", "x", "y")),
        *_span(),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("size", INTEGER, nullable=False),
    )
    op.execute(COPY_TILES)
    op.drop_table("old_tiles")
    with op.batch_alter_table("tiles") as tiles:
        tiles.create_primary_key("pk_tiles", ["map_id", "layer", "z", "x", "y", "since"])
    op.create_index("ix_tiles_since", "tiles", ["map_id", "since"])
    _index_ended("tiles")


def downgrade() -> None:
    """Back. The newest version of every map is kept."""
    op.drop_index("ix_tiles_until", "tiles")
    op.drop_index("ix_tiles_since", "tiles")
    op.execute("DELETE FROM tiles WHERE until IS NOT NULL OR layer = 'counts'")
    op.execute("UPDATE tiles SET since = (SELECT m.version FROM maps AS m WHERE m.id = tiles.map_id)")
    op.execute(OLDER_VERSIONS)
    with op.batch_alter_table("map_versions") as versions:
        versions.add_column(sa.Column("drives", sa.JSON(), nullable=False, server_default="[]"))
        versions.drop_column("drive_count")
        versions.drop_column("built_with")
    _restore_drives()
    with op.batch_alter_table("tiles") as tiles:
        tiles.drop_constraint("pk_tiles", type_="primary")
        tiles.drop_column("until")
        tiles.alter_column("since", new_column_name="version")
        tiles.create_primary_key("pk_tiles", ["map_id", "version", "layer", "z", "x", "y"])
    with op.batch_alter_table("submaps") as submaps:
        submaps.drop_column("track_t_ns")
        submaps.drop_column("track")
    for table in ("changed_boxes", "map_drives", "regions"):
        op.drop_table(table)


def _restore_drives() -> None:
    found: dict[str, list[str]] = {}
    for map_id, drive_id in op.get_bind().execute(sa.text("SELECT map_id, drive_id FROM map_drives WHERE until IS NULL")):
        found.setdefault(map_id, []).append(drive_id)
    for map_id, ids in found.items():
        op.get_bind().execute(
            sa.text("UPDATE map_versions SET drives = :drives WHERE map_id = :map_id"),
            {"drives": json.dumps(sorted(ids)), "map_id": map_id},
        )
