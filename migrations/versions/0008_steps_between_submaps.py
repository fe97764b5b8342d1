"""Keep what a drive tells of neighbouring submaps; rows of before have none."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("submaps") as submaps:
        submaps.add_column(sa.Column("step_before", sa.JSON(), nullable=True))


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("submaps") as submaps:
        submaps.drop_column("step_before")
