"""Keys, users, their sessions, the audit log, and owners of drives. Drives of before belong to the vehicle that they name."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

INTEGER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
SECONDS = sa.Float(53)
KEEPS = "the audit log is only ever added to"
FUNCTION = f"""
    CREATE FUNCTION wayloom_keep_audit() RETURNS trigger LANGUAGE plpgsql
    AS $$ BEGIN RAISE EXCEPTION '{KEEPS}'; END $$
"""


def upgrade() -> None:
    """Forward."""
    op.create_table(
        "access_keys",
        sa.Column("id", INTEGER, autoincrement=True, nullable=False),
        sa.Column("prefix", sa.String(16), nullable=False),
        sa.Column("name", sa.String(128), nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("vehicle_id", sa.String(128), nullable=True),
        sa.Column("secret", sa.String(64), nullable=False),
        sa.Column("old_secret", sa.String(64), nullable=True),
        sa.Column("old_until", SECONDS, nullable=True),
        sa.Column("created_at", SECONDS, nullable=False),
        sa.Column("expires_at", SECONDS, nullable=True),
        sa.Column("used_at", SECONDS, nullable=True),
        sa.Column("revoked_at", SECONDS, nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_access_keys")),
        sa.UniqueConstraint("prefix", name=op.f("uq_access_keys_prefix")),
    )
    op.create_table(
        "users",
        sa.Column("id", INTEGER, autoincrement=True, nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("password", sa.String(256), nullable=False),
        sa.Column("created_at", SECONDS, nullable=False),
        sa.Column("signed_in_at", SECONDS, nullable=True),
        sa.Column("failures", INTEGER, nullable=False),
        sa.Column("blocked_until", SECONDS, nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_users")),
        sa.UniqueConstraint("name", name=op.f("uq_users_name")),
    )
    op.create_table(
        "user_sessions",
        sa.Column("token", sa.String(64), nullable=False),
        sa.Column("user_id", INTEGER, nullable=False),
        sa.Column("address", sa.String(64), nullable=False),
        sa.Column("created_at", SECONDS, nullable=False),
        sa.Column("expires_at", SECONDS, nullable=False),
        sa.ForeignKeyConstraint(["user_id"], ["users.id"], name=op.f("fk_user_sessions_user_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("token", name=op.f("pk_user_sessions")),
    )
    op.create_index("ix_user_sessions_user_id", "user_sessions", ["user_id"])
    op.create_index("ix_user_sessions_expires_at", "user_sessions", ["expires_at"])
    op.create_table(
        "audit_log",
        sa.Column("id", INTEGER, autoincrement=True, nullable=False),
        sa.Column("at", SECONDS, nullable=False),
        sa.Column("actor", sa.String(160), nullable=False),
        sa.Column("role", sa.String(16), nullable=True),
        sa.Column("action", sa.String(256), nullable=False),
        sa.Column("object", sa.String(256), nullable=False),
        sa.Column("address", sa.String(64), nullable=False),
        sa.Column("status", INTEGER, nullable=False),
        sa.Column("outcome", sa.String(16), nullable=False),
        sa.Column("count", INTEGER, nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_log")),
    )
    op.create_index("ix_audit_log_actor_id", "audit_log", ["actor", "id"])
    _keep_audit()
    op.add_column("drives", sa.Column("owner", sa.String(160), nullable=True))
    op.create_index("ix_drives_owner", "drives", ["owner"])
    op.execute("UPDATE drives SET owner = 'vehicle ' || vehicle_id WHERE vehicle_id IS NOT NULL")


def _keep_audit() -> None:
    """The database itself refuses to change or to delete an entry."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute(FUNCTION)
        op.execute(
            "CREATE TRIGGER audit_log_keep BEFORE UPDATE OR DELETE ON audit_log FOR EACH ROW EXECUTE FUNCTION wayloom_keep_audit()"
        )
        return
    for event in ("UPDATE", "DELETE"):
        op.execute(
            f"CREATE TRIGGER audit_log_no_{event.lower()} BEFORE {event} ON audit_log BEGIN SELECT RAISE(ABORT, '{KEEPS}'); END"
        )


def downgrade() -> None:
    """Back."""
    op.drop_index("ix_drives_owner", "drives")
    op.drop_column("drives", "owner")
    op.drop_table("audit_log")
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION wayloom_keep_audit()")
    for name in ("user_sessions", "users", "access_keys"):
        op.drop_table(name)
