"""Let held drives be placed by their meetings, and submaps have no place; look for drives near each other by their own places.

Boxes for that look-up are known for submaps that come from now on; older ones get their own box and some 100 m around it. Held
drives that were judged before stay held until they are judged anew: whether anything but their place is in doubt was not kept.
"""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

SIDES = ("min_lon", "min_lat", "max_lon", "max_lat")
NEAR = ["map_id", "near_min_lon", "near_max_lon", "near_min_lat", "near_max_lat"]
AROUND = """
    UPDATE submaps SET near_min_lon = min_lon - 0.001, near_max_lon = max_lon + 0.001,
        near_min_lat = min_lat - 0.001, near_max_lat = max_lat + 0.001
"""


def upgrade() -> None:
    """Forward."""
    with op.batch_alter_table("drives") as drives:
        drives.add_column(sa.Column("sound", sa.Boolean(), nullable=True))
        drives.add_column(sa.Column("admitted", sa.Boolean(), nullable=False, server_default=sa.false()))
        drives.add_column(sa.Column("map_verdict", sa.JSON(), nullable=True))
    with op.batch_alter_table("submaps") as submaps:
        submaps.add_column(sa.Column("located", sa.Boolean(), nullable=False, server_default=sa.true()))
        submaps.alter_column("frame", existing_type=sa.JSON(), nullable=True)
        for side in SIDES:
            submaps.alter_column(side, existing_type=sa.Float(53), nullable=True)
            submaps.add_column(sa.Column(f"near_{side}", sa.Float(53), nullable=True))
    op.execute(AROUND)
    op.create_index("ix_submaps_near", "submaps", NEAR)
    with op.batch_alter_table("changed_boxes") as boxes:
        for side in SIDES:
            boxes.alter_column(side, existing_type=sa.Float(53), nullable=True)
    with op.batch_alter_table("meetings") as meetings:
        meetings.add_column(sa.Column("likeness", sa.Float(53), nullable=True))


def downgrade() -> None:
    """Back. Submaps without a place go, and drives that their meetings admitted leave their maps with the next version."""
    op.execute("DELETE FROM submaps WHERE min_lon IS NULL OR frame IS NULL OR NOT located")
    op.execute("DELETE FROM changed_boxes WHERE min_lon IS NULL")
    with op.batch_alter_table("meetings") as meetings:
        meetings.drop_column("likeness")
    op.drop_index("ix_submaps_near", "submaps")
    with op.batch_alter_table("changed_boxes") as boxes:
        for side in SIDES:
            boxes.alter_column(side, existing_type=sa.Float(53), nullable=False)
    with op.batch_alter_table("submaps") as submaps:
        for side in SIDES:
            submaps.drop_column(f"near_{side}")
            submaps.alter_column(side, existing_type=sa.Float(53), nullable=False)
        submaps.alter_column("frame", existing_type=sa.JSON(), nullable=False)
        submaps.drop_column("located")
    with op.batch_alter_table("drives") as drives:
        for name in ("map_verdict", "admitted", "sound"):
            drives.drop_column(name)
