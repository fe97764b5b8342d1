"""The first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "maps",
        sa.Column("id", sa.String(length=63), nullable=False),
        sa.Column("version", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_maps")),
    )
    op.create_table(
        "tiles",
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("version", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("layer", sa.String(length=32), nullable=False),
        sa.Column("z", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("x", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("y", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("size", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.PrimaryKeyConstraint("map_id", "version", "layer", "z", "x", "y", name=op.f("pk_tiles")),
    )
    op.create_table(
        "vehicles",
        sa.Column("id", sa.String(length=128), nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_vehicles")),
    )
    op.create_table(
        "drives",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=256), nullable=False),
        sa.Column("vehicle_id", sa.String(length=128), nullable=True),
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("manifest", sa.JSON(), nullable=False),
        sa.Column("file_count", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("byte_count", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("placed", sa.Boolean(), nullable=True),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.Column("track", sa.JSON(), nullable=True),
        sa.Column("stitch_job_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=True),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.Column("uploaded_at", sa.Float(precision=53), nullable=True),
        sa.Column("finished_at", sa.Float(precision=53), nullable=True),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_drives_map_id")),
        sa.ForeignKeyConstraint(["vehicle_id"], ["vehicles.id"], name=op.f("fk_drives_vehicle_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_drives")),
    )
    with op.batch_alter_table("drives", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_drives_created_at"), ["created_at"], unique=False)
        batch_op.create_index(batch_op.f("ix_drives_map_id"), ["map_id"], unique=False)
        batch_op.create_index(batch_op.f("ix_drives_state"), ["state"], unique=False)
        batch_op.create_index(batch_op.f("ix_drives_vehicle_id"), ["vehicle_id"], unique=False)

    op.create_table(
        "map_versions",
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("version", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.Column("frame", sa.JSON(), nullable=False),
        sa.Column("drives", sa.JSON(), nullable=False),
        sa.Column("submap_count", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("bounds", sa.JSON(), nullable=True),
        sa.Column("layers", sa.JSON(), nullable=False),
        sa.Column("tile_count", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("byte_count", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_map_versions_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("map_id", "version", name=op.f("pk_map_versions")),
    )
    op.create_table(
        "drive_files",
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("path", sa.String(length=1024), nullable=False),
        sa.Column("size", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("complete", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_drive_files_drive_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("drive_id", "path", name=op.f("pk_drive_files")),
    )
    op.create_table(
        "jobs",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("drive_id", sa.String(length=64), nullable=True),
        sa.Column("map_id", sa.String(length=63), nullable=True),
        sa.Column("parent_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=True),
        sa.Column("stage", sa.String(length=32), nullable=False),
        sa.Column("position", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("queue", sa.String(length=32), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempt", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("token", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("worker", sa.String(length=256), nullable=True),
        sa.Column("lease_until", sa.Float(precision=53), nullable=True),
        sa.Column("heartbeat_at", sa.Float(precision=53), nullable=True),
        sa.Column("sent_at", sa.Float(precision=53), nullable=True),
        sa.Column("progress", sa.Float(precision=53), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("payload", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.Column("started_at", sa.Float(precision=53), nullable=True),
        sa.Column("finished_at", sa.Float(precision=53), nullable=True),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_jobs_drive_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_jobs_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_jobs")),
        sa.UniqueConstraint("drive_id", "stage", name=op.f("uq_jobs_drive_id_stage")),
    )
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.create_index("ix_jobs_map_id_stage_state", ["map_id", "stage", "state"], unique=False)
        batch_op.create_index("ix_jobs_state_sent_at", ["state", "sent_at"], unique=False)

    op.create_table(
        "submaps",
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("position", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("map_id", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("point_count", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("frame", sa.JSON(), nullable=False),
        sa.Column("T_enu_submap", sa.JSON(), nullable=False),
        sa.Column("covariance", sa.JSON(), nullable=False),
        sa.Column("min_lon", sa.Float(precision=53), nullable=False),
        sa.Column("min_lat", sa.Float(precision=53), nullable=False),
        sa.Column("max_lon", sa.Float(precision=53), nullable=False),
        sa.Column("max_lat", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_submaps_drive_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_submaps_map_id")),
        sa.PrimaryKeyConstraint("drive_id", "position", name=op.f("pk_submaps")),
    )
    with op.batch_alter_table("submaps", schema=None) as batch_op:
        batch_op.create_index("ix_submaps_box", ["map_id", "min_lon", "max_lon", "min_lat", "max_lat"], unique=False)
        batch_op.create_index(batch_op.f("ix_submaps_map_id"), ["map_id"], unique=False)

    op.create_table(
        "uploads",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("path", sa.String(length=1024), nullable=False),
        sa.Column("length", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("metadata_header", sa.Text(), nullable=False),
        sa.Column("complete", sa.Boolean(), nullable=False),
        sa.Column("expires_at", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_uploads_drive_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_uploads")),
    )
    with op.batch_alter_table("uploads", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_uploads_drive_id"), ["drive_id"], unique=False)
        batch_op.create_index(batch_op.f("ix_uploads_expires_at"), ["expires_at"], unique=False)


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("uploads", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_uploads_expires_at"))
        batch_op.drop_index(batch_op.f("ix_uploads_drive_id"))

    op.drop_table("uploads")
    with op.batch_alter_table("submaps", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_submaps_map_id"))
        batch_op.drop_index("ix_submaps_box")

    op.drop_table("submaps")
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.drop_index("ix_jobs_state_sent_at")
        batch_op.drop_index("ix_jobs_map_id_stage_state")

    op.drop_table("jobs")
    op.drop_table("drive_files")
    op.drop_table("map_versions")
    with op.batch_alter_table("drives", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_drives_vehicle_id"))
        batch_op.drop_index(batch_op.f("ix_drives_state"))
        batch_op.drop_index(batch_op.f("ix_drives_map_id"))
        batch_op.drop_index(batch_op.f("ix_drives_created_at"))

    op.drop_table("drives")
    op.drop_table("vehicles")
    op.drop_table("tiles")
    op.drop_table("maps")
