"""What has gone from a region and what is new in it."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None
INTEGER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Forward. Regions of before have no list: the map is made anew by other code."""
    with op.batch_alter_table("regions") as regions:
        regions.add_column(sa.Column("changes", sa.JSON(), nullable=False, server_default="[]"))
        regions.add_column(sa.Column("change_count", INTEGER, nullable=False, server_default="0"))


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("regions") as regions:
        regions.drop_column("change_count")
        regions.drop_column("changes")
