"""Workers that a job has lost, and when a job may be tried again."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("jobs") as jobs:
        jobs.add_column(sa.Column("losses", sa.JSON(), nullable=False, server_default="[]"))
        jobs.add_column(sa.Column("not_before", sa.Float(53), nullable=True))


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("jobs") as jobs:
        jobs.drop_column("not_before")
        jobs.drop_column("losses")
