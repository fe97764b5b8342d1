"""Callers: who sends a request, by its key or its session, held in memory for some seconds."""

import time
from collections import OrderedDict
from collections.abc import MutableMapping
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final

from starlette.datastructures import Headers
from starlette.requests import cookie_parser

from wayloom.config.roles import RIGHTS, Right, Role
from wayloom.config.service import ServiceSettings
from wayloom.store.access import keys, users
from wayloom.store.access.owners import Owner, owner_of
from wayloom.store.access.secrets import hash_of, is_same
from wayloom.store.database import Database, DatabaseError
from wayloom_services.access.needs import Need, Open

CALLER: Final = "wayloom.caller"
"""Where a request's scope holds its caller."""
COOKIE: Final = "wayloom"
COOKIE_OF_HTTPS: Final = "__Host-wayloom"
"""A browser takes a cookie of this name only over https, from this host itself, for all paths."""
MOST_HELD: Final = 4096


@dataclass(frozen=True, slots=True)
class Caller:
    """Who sends a request.

    name       as the audit log has it: `key PREFIX`, `user NAME`, `api key`, `this machine`, `nobody`
    role       None of nobody
    owner      of a vehicle: whose drives alone it sees and sends
    by_cookie  whether a browser sends what tells who it is by itself, to whatever page asks it to
    """

    name: str
    role: Role | None
    owner: Owner | None = None
    by_cookie: bool = False

    def may(self, need: Need) -> bool:
        """Whether the caller has what a route needs."""
        if isinstance(need, Right):
            return self.role is not None and need in RIGHTS[self.role]
        return need is Open.TO_ALL or self.role is not None


NOBODY: Final = Caller("nobody", None)
OF_THIS_MACHINE: Final = Caller("this machine", Role.ADMIN)
OF_API_KEY: Final = Caller("api key", Role.ADMIN)


@dataclass(frozen=True, slots=True)
class Credential:
    """A key, or the token of a session, as a request brings it."""

    text: str
    is_cookie: bool


def credential_of(headers: Headers, is_https: bool) -> Credential | None:
    """The request's Bearer token, else its cookie. A cookie that was set over http is not taken over https."""
    scheme, _, given = headers.get("authorization", "").partition(" ")
    if scheme:
        return Credential(given.strip(), False) if scheme.lower() == "bearer" else None
    token = cookie_parser(headers.get("cookie", "")).get(COOKIE_OF_HTTPS if is_https else COOKIE)
    return Credential(token, True) if token else None


class Callers:
    """Finds callers. Safe to share between threads.

    A key or session that was found is held for `held_s`: one that another process revokes is taken by this one for so long at
    most. What this process revokes itself it forgets at once. What was not found is not held.
    """

    def __init__(self, database: Database, settings: ServiceSettings) -> None:
        self._database, self._api_key, self._held_s = database, settings.api_key, settings.access.held_s
        self._held: OrderedDict[tuple[bool, str], tuple[float, Caller]] = OrderedDict()
        self._forgotten, self._lock = 0, Lock()

    def held(self, given: Credential) -> Caller | None:
        """The caller, without asking the database; None where it has to be asked."""
        if not given.is_cookie and self._api_key is not None and is_same(given.text, self._api_key):
            return OF_API_KEY
        with self._lock:
            until, caller = self._held.get((given.is_cookie, hash_of(given.text)), (0.0, NOBODY))
        return caller if time.monotonic() < until else None

    def find(self, given: Credential) -> Caller:
        """The caller by the database; NOBODY where the key or session is unknown, expired or revoked. Raises DatabaseError."""
        since = self._forgotten
        with self._database.read() as session:
            key = None if given.is_cookie else keys.find(session, given.text)
            signed_in = users.find_session(session, given.text) if given.is_cookie else None
        if key is not None:
            if key.is_note_due:
                self._note_use(key.key_id)
            owner = owner_of(key.prefix, key.vehicle_id) if key.role is Role.VEHICLE else None
            lasts_s = self._held_s if key.until is None else min(self._held_s, key.until - key.at)
            return self._hold(given, Caller(f"key {key.prefix}", key.role, owner), lasts_s, since)
        if signed_in is not None:
            caller = Caller(f"user {signed_in.user}", signed_in.role, by_cookie=True)
            return self._hold(given, caller, min(self._held_s, signed_in.until - signed_in.at), since)
        return NOBODY

    def forget(self) -> None:
        """Ask the database anew about everybody: something was revoked."""
        with self._lock:
            self._forgotten += 1
            self._held.clear()

    def _hold(self, given: Credential, caller: Caller, lasts_s: float, since: int) -> Caller:
        """since: how often all was forgotten when the database was asked: what it said before a revocation is not held after."""
        with self._lock:
            if since != self._forgotten:
                return caller
            self._held[given.is_cookie, hash_of(given.text)] = (time.monotonic() + lasts_s, caller)
            if len(self._held) > MOST_HELD:
                self._held.popitem(last=False)
        return caller

    def _note_use(self, key_id: int) -> None:
        with suppress(DatabaseError), self._database.write() as session:  # a full disk keeps nobody from reading
            keys.note_use(session, key_id)


def caller_of(scope: MutableMapping[str, Any]) -> Caller:
    """The caller of a request that has passed the guard; NOBODY of one that has not."""
    found: Caller = scope.get(CALLER, NOBODY)
    return found
