"""What a drive says of its rig's GNSS clock and lever arm."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("rig_evidence") as evidence:
        evidence.add_column(sa.Column("receiver", sa.JSON(), nullable=True))


def downgrade() -> None:
    """Back."""
    with op.batch_alter_table("rig_evidence") as evidence:
        evidence.drop_column("receiver")
