"""Repository of users and their sessions."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from wayloom.config.backoff import Backoff
from wayloom.config.roles import Role
from wayloom.errors import ConfigError, ConflictError, NotFoundError
from wayloom.store.access.passwords import password_hash
from wayloom.store.access.secrets import hash_of, new_token
from wayloom.store.database import now_s
from wayloom.store.tables.access import User, UserSession

NAME: Final = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
FREE_FAILURES: Final = 5
"""Wrong passwords in a row that cost no waiting."""
WAIT: Final = Backoff(2.0, 300.0)
"""After them: each doubles the pause before the next is tried, up to a longest, so that nobody locks somebody out for good."""

FOR_GOOD: Final = 253_402_300_800.0
"""`blocked_until` of a user who is disabled: the year 10000."""
PROVIDED: Final = "oidc "
"""How `password` begins of a user whom an OpenID provider signs in (`provided`)."""


@dataclass(frozen=True, slots=True)
class KnownSession:
    """A session whose token was given and is good. until, at: seconds since 1970, as of `KnownKey`."""

    user: str
    role: Role
    until: float
    at: float


def add(session: Session, name: str, role: Role, password: str) -> User:
    """A new user. Raises ConfigError, ConflictError."""
    if not NAME.fullmatch(name):
        raise ConfigError(f"{name[:80]!r} is no name of a user", remedy="use small letters, digits, dots, dashes")
    if role is Role.VEHICLE:
        raise ConfigError("a vehicle does not sign in", remedy="give it a key: wayloom keys create")
    if session.scalars(select(User.id).where(User.name == name)).first() is not None:
        raise ConflictError(f"there is a user {name} already")
    row = User(name=name, role=role.value, password=password_hash(password), created_at=now_s(session), failures=0)
    session.add(row)
    session.flush()
    return row


def every(session: Session) -> Sequence[User]:
    """All users by name."""
    return session.scalars(select(User).order_by(User.name)).all()


def get(session: Session, name: str) -> User:
    """The user. Raises NotFoundError."""
    row = held(session, name)
    if row is None:
        raise NotFoundError(f"there is no user {name[:80]!r}")
    return row


def named(session: Session, name: str) -> User | None:
    """The user of a name, None where there is none."""
    return session.scalars(select(User).where(User.name == name)).first() if NAME.fullmatch(name) else None


def held(session: Session, name: str) -> User | None:
    """As `named`; nobody else may change the user until this transaction ends."""
    return session.scalars(select(User).where(User.name == name).with_for_update()).first() if NAME.fullmatch(name) else None


def set_password(session: Session, name: str, password: str) -> User:
    """Another password: every session of the user ends. Raises NotFoundError, ConfigError."""
    row = get(session, name)
    if is_provided(row):
        raise ConfigError(f"{name} signs in by the OpenID provider", remedy="change the password there")
    row.password, row.failures = password_hash(password), 0
    row.blocked_until = FOR_GOOD if is_disabled(row) else None
    end_sessions(session, row)
    return row


def disable(session: Session, name: str) -> User:
    """The user's sessions end, and none begins until `enable`: neither by a password nor by a provider. Raises NotFoundError."""
    row = get(session, name)
    row.blocked_until = FOR_GOOD
    end_sessions(session, row)
    return row


def enable(session: Session, name: str) -> User:
    """The user may sign in again. Raises NotFoundError."""
    row = get(session, name)
    row.failures, row.blocked_until = 0, None
    return row


def is_disabled(user: User) -> bool:
    """Whether the user is kept out until somebody says otherwise."""
    return user.blocked_until is not None and user.blocked_until >= FOR_GOOD


def is_provided(user: User) -> bool:
    """Whether an OpenID provider signs the user in."""
    return user.password.startswith(PROVIDED)


def end_sessions(session: Session, user: User) -> None:
    """Every session of the user ends."""
    session.execute(delete(UserSession).where(UserSession.user_id == user.id))


def remove(session: Session, name: str) -> User:
    """The user and the sessions go. Raises NotFoundError."""
    row = get(session, name)
    session.delete(row)
    session.flush()
    return row


def note_failure(session: Session, user: User) -> None:
    """A wrong password: after some, none is tried for a while."""
    user.failures += 1
    if user.failures > FREE_FAILURES:
        user.blocked_until = now_s(session) + WAIT.pause_s(user.failures - FREE_FAILURES)


def sign_in(session: Session, user: User, address: str, session_s: float) -> str:
    """A new session of a user whose password was right. Returns its token, which nobody has seen before: not one that the
    browser brought along. Sessions that are over go."""
    now, token = now_s(session), new_token()
    user.failures, user.blocked_until, user.signed_in_at = 0, None, now
    session.execute(delete(UserSession).where(UserSession.expires_at <= now))
    session.add(
        UserSession(token=hash_of(token), user_id=user.id, address=address[:64], created_at=now, expires_at=now + session_s)
    )
    return token


def find_session(session: Session, token: str) -> KnownSession | None:
    """The session of a token, by its primary key; None where there is none or it is over."""
    query = select(User.name, User.role, UserSession.expires_at).join(User, User.id == UserSession.user_id)
    row = session.execute(query.where(UserSession.token == hash_of(token))).first()
    now = now_s(session)
    return None if row is None or row.expires_at <= now else KnownSession(row.name, Role(row.role), row.expires_at, now)


def sign_out(session: Session, token: str) -> None:
    """The session of a token ends."""
    session.execute(delete(UserSession).where(UserSession.token == hash_of(token)))
