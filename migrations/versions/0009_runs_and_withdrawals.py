"""Keep the runs of drives, process drives anew beside what they have, and withdraw versions that held a removed drive.

Drives that are there have no run yet: their lineage begins with the next one.
"""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

INTEGER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
REMOVED = "UPDATE map_drives SET removed = true WHERE drive_id NOT IN (SELECT id FROM drives)"


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "drive_runs",
        sa.Column("drive_id", sa.String(length=64), nullable=False),
        sa.Column("number", INTEGER, nullable=False),
        *(sa.Column(name, sa.JSON(), nullable=False) for name in ("stages", "submaps", "asked")),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], name=op.f("fk_drive_runs_drive_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("drive_id", "number", name=op.f("pk_drive_runs")),
    )
    op.create_table(
        "forgotten_blobs",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("stage", sa.String(length=32), nullable=False),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_forgotten_blobs")),
    )
    with op.batch_alter_table("drives") as drives:
        drives.add_column(sa.Column("coming", sa.JSON(), nullable=True))
    with op.batch_alter_table("map_versions") as versions:
        versions.add_column(sa.Column("withdrawn_at", sa.Float(precision=53), nullable=True))
    with op.batch_alter_table("map_drives") as held:
        held.add_column(sa.Column("removed", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.execute(REMOVED)


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("map_drives") as held:
        held.drop_column("removed")
    with op.batch_alter_table("map_versions") as versions:
        versions.drop_column("withdrawn_at")
    with op.batch_alter_table("drives") as drives:
        drives.drop_column("coming")
    op.drop_table("forgotten_blobs")
    op.drop_table("drive_runs")
