"""The markings and kerbs of a region."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward. Regions of before have none: the map is made anew by other code."""
    with op.batch_alter_table("regions") as regions:
        regions.add_column(sa.Column("markings", sa.String(64), nullable=False, server_default=""))


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("regions") as regions:
        regions.drop_column("markings")
