"""Tables of access control. Secrets and tokens are kept as SHA-256, passwords as argon2id; none of them can be read back."""

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from wayloom.store.tables.base import DIGEST, Base


class AccessKey(Base):
    """A key of a vehicle or a program.

    prefix      public part, by which it is looked up and called in logs
    role        vehicle, viewer, operator or admin
    vehicle_id  the vehicle whose drives alone it sends (None: of any)
    secret      SHA-256 of the whole key; old_secret, old_until: of the one before its rotation, and until when that is taken
    used_at     when it was last used, to some minutes
    """

    __tablename__ = "access_keys"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    prefix: Mapped[str] = mapped_column(String(16), unique=True)
    name: Mapped[str] = mapped_column(String(128))
    role: Mapped[str] = mapped_column(String(16))
    vehicle_id: Mapped[str | None] = mapped_column(String(128))
    secret: Mapped[str] = mapped_column(DIGEST)
    old_secret: Mapped[str | None] = mapped_column(DIGEST)
    old_until: Mapped[float | None]
    created_at: Mapped[float]
    expires_at: Mapped[float | None]
    used_at: Mapped[float | None]
    revoked_at: Mapped[float | None]


class User(Base):
    """A person who signs in.

    password  argon2id; or `oidc ` and the SHA-256 of issuer and subject, of whom an OpenID provider signs in: no password is right
    failures  wrong passwords since the last right one; blocked_until: none is tried before (`users.FOR_GOOD`: disabled)
    """

    __tablename__ = "users"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    name: Mapped[str] = mapped_column(String(64), unique=True)
    role: Mapped[str] = mapped_column(String(16))
    password: Mapped[str] = mapped_column(String(256))
    created_at: Mapped[float]
    signed_in_at: Mapped[float | None]
    failures: Mapped[int] = mapped_column(default=0)
    blocked_until: Mapped[float | None]


class UserSession(Base):
    """A sign-in of a user. token: SHA-256 of what the browser's cookie holds."""

    __tablename__ = "user_sessions"
    token: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    user_id: Mapped[int] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    address: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[float]
    expires_at: Mapped[float] = mapped_column(index=True)


class AuditEntry(Base):
    """A change that somebody asked for, or a request that was refused. The database refuses to change or delete a row.

    actor    `key PREFIX`, `user NAME`, `api key`, `this machine`, `command line of USER`, or `nobody`
    action   method and template of the route; object: the drive, upload or other thing in the request's path
    outcome  done, refused or failed; count: how many that were alike it stands for (refused ones, within a second)
    """

    __tablename__ = "audit_log"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[float]
    actor: Mapped[str] = mapped_column(String(160))
    role: Mapped[str | None] = mapped_column(String(16))
    action: Mapped[str] = mapped_column(String(256))
    object: Mapped[str] = mapped_column(String(256))
    address: Mapped[str] = mapped_column(String(64))
    status: Mapped[int]
    outcome: Mapped[str] = mapped_column(String(16))
    count: Mapped[int] = mapped_column(default=1)
    __table_args__ = (Index("ix_audit_log_actor_id", "actor", "id"),)
