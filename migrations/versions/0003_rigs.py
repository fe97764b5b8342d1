"""Rigs, what their drives say of them, and the versions of their files."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

INTEGER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "rigs",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("vehicle_id", sa.String(length=128), nullable=True),
        sa.Column("rig_id", sa.String(length=256), nullable=True),
        sa.Column("revision", INTEGER, nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_rigs")),
    )
    op.create_table(
        "rig_evidence",
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("rig", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("own_digest", sa.String(length=64), nullable=False),
        sa.Column("t_ns", INTEGER, nullable=False),
        sa.Column("scale", sa.JSON(), nullable=True),
        sa.Column("from_ns", INTEGER, nullable=False),
        sa.Column("chi_square", sa.Float(precision=53), nullable=True),
        sa.Column("stray", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_rig_evidence_drive_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["rig"], ["rigs.id"], name=op.f("fk_rig_evidence_rig")),
        sa.PrimaryKeyConstraint("drive_id", name=op.f("pk_rig_evidence")),
    )
    op.create_index("ix_rig_evidence_rig", "rig_evidence", ["rig"])
    op.create_table(
        "rig_versions",
        sa.Column("rig", sa.String(length=32), nullable=False),
        sa.Column("version", INTEGER, nullable=False),
        sa.Column("from_ns", INTEGER, nullable=False),
        sa.Column("evidence", sa.String(length=64), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("drives", sa.JSON(), nullable=False),
        sa.Column("reason", sa.String(length=64), nullable=False),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(["rig"], ["rigs.id"], name=op.f("fk_rig_versions_rig")),
        sa.PrimaryKeyConstraint("rig", "version", name=op.f("pk_rig_versions")),
    )
    op.create_index("ix_rig_versions_digest", "rig_versions", ["digest"])


def downgrade() -> None:
    """Back."""
    op.drop_table("rig_versions")
    op.drop_table("rig_evidence")
    op.drop_table("rigs")
