"""Uploads of many small files at once: how many of a pack's files are stored."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("uploads") as uploads:
        uploads.add_column(sa.Column("files_done", sa.BigInteger().with_variant(sa.Integer, "sqlite"), nullable=True))


def downgrade() -> None:
    """Back."""
    op.execute("DELETE FROM uploads WHERE files_done IS NOT NULL")
    with op.batch_alter_table("uploads") as uploads:
        uploads.drop_column("files_done")
