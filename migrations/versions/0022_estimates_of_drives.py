"""Estimates of drives: the intervals of remaining time that were told, and the truth."""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0020"
branch_labels = None
depends_on = None

BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "drive_estimates",
        sa.Column("id", BIG, autoincrement=True, nullable=False),
        sa.Column("drive_id", sa.String(length=64), nullable=True),
        sa.Column("at", sa.Float(precision=53), nullable=False),
        sa.Column("stage", sa.String(length=32), nullable=False),
        sa.Column("expected_s", sa.Float(precision=53), nullable=False),
        sa.Column("low_s", sa.Float(precision=53), nullable=False),
        sa.Column("high_s", sa.Float(precision=53), nullable=False),
        sa.Column("rough", sa.Boolean(), nullable=False),
        sa.Column("truth_s", sa.Float(precision=53), nullable=True),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_drive_estimates_drive_id"), ondelete="SET NULL"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_drive_estimates")),
    )
    op.create_index("ix_drive_estimates_drive_id", "drive_estimates", ["drive_id"])


def downgrade() -> None:
    """Back."""
    op.drop_table("drive_estimates")
