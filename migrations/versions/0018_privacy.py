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
    op.create_index("ix_submaps_digest", "submaps", ["digest"])


def downgrade() -> None:
    """Back."""
    op.drop_index("ix_submaps_digest", "submaps")
    with op.batch_alter_table("drives") as drives:
        drives.drop_index("ix_drives_images")
        drives.drop_column("images_since")
        drives.drop_column("images")
