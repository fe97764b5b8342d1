"""Images of drives that are deleted, and areas of which nothing is kept."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("drives") as drives:
        drives.add_column(sa.Column("images", sa.String(16), nullable=False, server_default="kept"))
        drives.add_column(sa.Column("images_since", sa.Float(53), nullable=True))
        drives.create_index("ix_drives_images", ["images"])
    op.add_column("submaps", sa.Column("clipped_with", sa.String(64), nullable=False, server_default=""))
    big = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.create_table(
        "excluded_areas",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("map_id", sa.String(63), nullable=False),
        sa.Column("name", sa.String(256), nullable=False),
        sa.Column("geometry", sa.JSON(), nullable=False),
        *(sa.Column(name, sa.Float(53), nullable=False) for name in ("min_lon", "min_lat", "max_lon", "max_lat")),
        sa.Column("source", sa.String(16), nullable=False),
        sa.Column("created_at", sa.Float(53), nullable=False),
        sa.Column("since", big, nullable=True),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name="fk_excluded_areas_map_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name="pk_excluded_areas"),
    )
    op.create_index("ix_excluded_areas_map_id", "excluded_areas", ["map_id"])
    op.create_index("ix_submaps_digest", "submaps", ["digest"])


def downgrade() -> None:
    """Back."""
    op.drop_index("ix_submaps_digest", "submaps")
    op.drop_table("excluded_areas")
    # no batch: it would make a table anew, without its triggers, and dropping the old one deletes what refers to its rows
    op.drop_column("submaps", "clipped_with")
    op.drop_index("ix_drives_images", "drives")
    op.drop_column("drives", "images_since")
    op.drop_column("drives", "images")
