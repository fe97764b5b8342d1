"""Repository of keys: made, looked up by prefix, rotated, revoked."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from wayloom.config.roles import Role
from wayloom.errors import ConfigError, ConflictError, NotFoundError
from wayloom.store.access.secrets import NO_SECRET, hash_of, is_same, key_text, new_prefix, new_token, prefix_of
from wayloom.store.database import now_s
from wayloom.store.tables.access import AccessKey

USED_EVERY_S: Final = 300.0
"""How exactly it is known when a key was last used: a write each time would make reads writes."""


@dataclass(frozen=True, slots=True)
class KnownKey:
    """A key that was given and is good. until: seconds since 1970 at which it is no more (None: never); at: now, likewise."""

    key_id: int
    prefix: str
    role: Role
    vehicle_id: str | None
    until: float | None
    at: float
    is_note_due: bool


def create(
    session: Session, name: str, role: Role, vehicle_id: str | None = None, expires_in_s: float | None = None
) -> tuple[AccessKey, str]:
    """A new key, and its text, which is shown this once. Raises ConfigError."""
    if vehicle_id is not None and role is not Role.VEHICLE:
        raise ConfigError(
            f"a key of the role {role} is not bound to a vehicle", remedy="leave the vehicle out, or give the role vehicle"
        )
    now, prefix = now_s(session), new_prefix()
    text = key_text(prefix, new_token())
    until = None if expires_in_s is None else now + expires_in_s
    row = AccessKey(
        prefix=prefix, name=name, role=role.value, vehicle_id=vehicle_id, secret=hash_of(text), created_at=now, expires_at=until
    )
    session.add(row)
    session.flush()
    return row, text


def find(session: Session, text: str) -> KnownKey | None:
    """The key of this text, by one indexed read; None where there is none, or it has expired or is revoked.

    The same comparisons are made whether or not there is a row, so that the time tells nothing of it.
    """
    prefix = prefix_of(text)
    row = None if prefix is None else session.scalars(select(AccessKey).where(AccessKey.prefix == prefix)).first()
    now, given = now_s(session), hash_of(text)
    is_newest = is_same(given, NO_SECRET if row is None else row.secret)
    is_older = is_same(given, NO_SECRET if row is None or row.old_secret is None else row.old_secret)
    if row is None or row.revoked_at is not None:
        return None
    ends = [one for one in (row.expires_at, None if is_newest else row.old_until) if one is not None]
    until = min(ends, default=None)
    if not (is_newest or is_older) or (until is not None and until <= now):
        return None
    is_note_due = row.used_at is None or now - row.used_at > USED_EVERY_S
    return KnownKey(row.id, row.prefix, Role(row.role), row.vehicle_id, until, now, is_note_due)


def note_use(session: Session, key_id: int) -> None:
    """The key is used now."""
    session.execute(update(AccessKey).where(AccessKey.id == key_id).values(used_at=now_s(session)))


def every(session: Session) -> Sequence[AccessKey]:
    """All keys, newest first, those that are revoked too."""
    return session.scalars(select(AccessKey).order_by(AccessKey.id.desc())).all()


def get(session: Session, prefix: str) -> AccessKey:
    """The key. Raises NotFoundError."""
    row = session.scalars(select(AccessKey).where(AccessKey.prefix == prefix).with_for_update()).first()
    if row is None:
        raise NotFoundError(f"there is no key {prefix[:16]!r}")
    return row


def rotate(session: Session, prefix: str, grace_s: float) -> tuple[AccessKey, str]:
    """A new secret for the key; the one before is taken for `grace_s` more. Returns the key's new text.

    Raises NotFoundError, ConflictError.
    """
    row = _living(session, prefix)
    text = key_text(prefix, new_token())
    row.old_secret, row.old_until, row.secret = row.secret, now_s(session) + grace_s, hash_of(text)
    session.flush()
    return row, text


def revoke(session: Session, prefix: str) -> AccessKey:
    """The key is good no more, from now on. Raises NotFoundError, ConflictError."""
    row = _living(session, prefix)
    row.revoked_at, row.old_secret, row.old_until = now_s(session), None, None
    session.flush()
    return row


def _living(session: Session, prefix: str) -> AccessKey:
    row = get(session, prefix)
    if row.revoked_at is not None:
        raise ConflictError(f"key {prefix} is revoked: make a new one")
    return row
