"""History of drives: what became of each attempt at their stages."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "drive_events",
        sa.Column("id", BIG, autoincrement=True, nullable=False),
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("at", sa.Float(precision=53), nullable=False),
        sa.Column("stage", sa.String(length=32), nullable=False),
        sa.Column("part", BIG, nullable=False),
        sa.Column("attempt", BIG, nullable=False),
        sa.Column("what", sa.String(length=16), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("worker", sa.String(length=256), nullable=True),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_drive_events_drive_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_drive_events")),
    )
    op.create_index("ix_drive_events_drive_id", "drive_events", ["drive_id"])


def downgrade() -> None:
    """Back."""
    op.drop_table("drive_events")
