"""The areas and objects of a region."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward. Regions of before have none: the map is made anew by other code."""
    with op.batch_alter_table("regions") as regions:
        for name in ("areas", "objects"):
            regions.add_column(sa.Column(name, sa.String(64), nullable=False, server_default=""))


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("regions") as regions:
        for name in ("objects", "areas"):
            regions.drop_column(name)
