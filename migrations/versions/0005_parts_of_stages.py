"""Let a stage of a drive be made in parts, each a job of its own."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("jobs") as jobs:
        number = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
        jobs.add_column(sa.Column("part", number, nullable=False, server_default="0"))
        jobs.drop_constraint("uq_jobs_drive_id_stage", type_="unique")
        jobs.create_unique_constraint("uq_jobs_drive_id_stage_part", ["drive_id", "stage", "part"])


def downgrade() -> None:
    """Back."""
    op.execute("DELETE FROM jobs WHERE part > 0")
    with op.batch_alter_table("jobs") as jobs:
        jobs.drop_constraint("uq_jobs_drive_id_stage_part", type_="unique")
        jobs.create_unique_constraint("uq_jobs_drive_id_stage", ["drive_id", "stage"])
        jobs.drop_column("part")
