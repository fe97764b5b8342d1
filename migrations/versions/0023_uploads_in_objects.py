"""Uploads in an object store: the parts of each, and which of them hold a drive's file."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None

BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "upload_parts",
        sa.Column("upload_id", sa.String(length=32), nullable=False),
        sa.Column("start", BIG, autoincrement=False, nullable=False),
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("length", BIG, nullable=False),
        sa.Column("name", sa.String(length=256), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_upload_parts_drive_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("upload_id", "start", name=op.f("pk_upload_parts")),
    )
    op.create_index("ix_upload_parts_drive_id", "upload_parts", ["drive_id"])
    with op.batch_alter_table("drive_files") as files:
        files.add_column(sa.Column("upload_id", sa.String(length=32), nullable=True))
        files.add_column(sa.Column("upload_start", BIG, nullable=True))


def downgrade() -> None:
    """Back. What lies in an object store alone can be read no more: those drives are to be sent again."""
    op.execute("UPDATE drive_files SET complete = FALSE WHERE upload_id IS NOT NULL")
    with op.batch_alter_table("drive_files") as files:
        files.drop_column("upload_start")
        files.drop_column("upload_id")
    op.drop_table("upload_parts")
