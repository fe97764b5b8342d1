"""Users whom an OpenID provider signs in: a row each, made at the first sign-in, its role renewed at every one.

Issuer and subject alone say who it is (OpenID Connect Core 1.0, section 5.7): names and addresses may be given to somebody else.
The row's name is for people to read, and ends in letters of that identity, so that it is never the name of another user.
"""

import hashlib
import json
import re

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from wayloom.config.roles import Role
from wayloom.errors import ConflictError
from wayloom.store.access.users import PROVIDED, end_sessions
from wayloom.store.database import now_s
from wayloom.store.tables.access import User


def renewed(session: Session, issuer: str, subject: str, called: str, role: Role | None) -> User | None:
    """The user of a subject with the role that the provider tells now, made where there is none yet.

    called : what the provider calls the user, for the name of a new row
    role   : None where the provider gives none: None is returned, and sessions of an earlier sign-in end
    Raises ConflictError where somebody else has the name.
    """
    identity = hashlib.sha256(json.dumps([issuer, subject]).encode()).hexdigest()
    row = _known(session, identity)
    if role is None:
        if row is not None:
            end_sessions(session, row)
        return None
    if row is None:
        row = _made(session, identity, called, role)
    row.role = role.value
    return row


def _known(session: Session, identity: str) -> User | None:
    return session.scalars(select(User).where(User.password == PROVIDED + identity).with_for_update()).first()


def _made(session: Session, identity: str, called: str, role: Role) -> User:
    name = f"{_stem(called)}-{identity[:12]}"
    row = User(name=name, role=role.value, password=PROVIDED + identity, created_at=now_s(session), failures=0)
    try:
        with session.begin_nested():
            session.add(row)
    except IntegrityError:  # two first sign-ins at once
        known = _known(session, identity)
        if known is None:
            raise ConflictError(f"there is another user {name}") from None
        return known
    return row


def _stem(called: str) -> str:
    """In the letters of a user's name, without the host of a mail address."""
    letters = re.sub(r"[^a-z0-9._-]+", "-", called.partition("@")[0].lower()).strip("._-")
    return letters[:40] or "user"
