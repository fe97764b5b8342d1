"""Find the publish job of a stitch without reading every job."""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    op.create_index("ix_jobs_parent_id", "jobs", ["parent_id"])


def downgrade() -> None:
    """Back."""
    op.drop_index("ix_jobs_parent_id", "jobs")
