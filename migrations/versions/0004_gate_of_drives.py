"""Grade, gate and release of drives. What is in the map stays there; a drive without a place is held."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("drives", schema=None) as batch_op:
        batch_op.add_column(sa.Column("grade", sa.String(length=1), nullable=True))
        batch_op.add_column(sa.Column("gate", sa.String(length=16), nullable=True))
        batch_op.add_column(sa.Column("reasons", sa.JSON(), nullable=True))
        batch_op.add_column(sa.Column("released_at", sa.Float(precision=53), nullable=True))
        batch_op.add_column(sa.Column("released_by", sa.String(length=128), nullable=True))
        batch_op.add_column(sa.Column("released_why", sa.Text(), nullable=True))
    columns = (sa.column("placed", sa.Boolean()), sa.column("state", sa.String()), sa.column("gate", sa.String()))
    drives = sa.table("drives", *columns)
    op.execute(drives.update().where(drives.c.placed.is_(True)).values(gate="merge"))
    op.execute(drives.update().where(drives.c.placed.is_(False)).values(gate="hold"))
    op.execute(drives.update().where(drives.c.placed.is_(False), drives.c.state == "done").values(state="held"))


def downgrade() -> None:
    """Back."""
    op.execute("UPDATE drives SET state = 'done' WHERE state IN ('held', 'quarantined')")
    with op.batch_alter_table("drives", schema=None) as batch_op:
        for name in ("released_why", "released_by", "released_at", "reasons", "gate", "grade"):
            batch_op.drop_column(name)
