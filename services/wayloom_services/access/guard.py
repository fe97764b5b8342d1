"""Guard before every route: who asks, how often, whether the route and the thing that it names are the caller's, and the trail."""

import time
from typing import Any, Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wayloom.config.roles import Right
from wayloom.errors import WayloomError
from wayloom.store.access import owners
from wayloom.store.access.audit import Noted
from wayloom.store.database import DatabaseError
from wayloom_services.access.callers import CALLER, NOBODY, OF_THIS_MACHINE, Caller, caller_of, credential_of
from wayloom_services.access.needs import BY_GET, SESSION, Asked, asked, methods_of
from wayloom_services.context import Service
from wayloom_services.errors import ProtocolError, answer_to, no_key

OBJECT: Final = "wayloom.object"
"""Where a route says in the scope what its request is about, where the path does not tell."""
PAGE_HEADER: Final = "x-requested-with"
PAGE: Final = "wayloom"
"""What the dashboard sends along. A page of another origin cannot, without a preflight that this server does not allow."""
UPLOADS: Final = "/v1/uploads"
REFUSED: Final = frozenset({401, 403, 429})


class Guard:
    """ASGI middleware.

    Nothing of a request's body is read before it has passed. A change is in the audit log before its answer goes out, but for the
    pieces of uploads, which are gathered for a second.
    """

    def __init__(self, app: ASGIApp, service: Service) -> None:
        self._app, self._service = app, service
        self._is_closed = service.settings.is_closed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request through, or answer it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        route = asked(scope["method"], scope["path"])
        try:
            scope[CALLER] = await self._caller(scope)
            await self._check(scope, route)
        except WayloomError as error:
            answer = answer_to(error)
            if route is not None or answer.status_code in REFUSED:
                self._service.trail.gather(_noted(scope, route, answer.status_code, is_refused=answer.status_code < 500))
            scope["route"] = route  # for the metrics
            await answer(scope, receive, send)
            return
        assert route is not None
        if not route.changes:
            await self._app(scope, receive, send)
            return

        async def noting(message: Message) -> None:
            if message["type"] == "http.response.start":
                await self._note(scope, route, message["status"])
            await send(message)

        try:
            await self._app(scope, receive, noting)
        except Exception:
            await self._note(scope, route, 500)
            raise

    async def _caller(self, scope: Scope) -> Caller:
        """Raises ProtocolError for a flood, and where the database is away."""
        if not self._is_closed:
            return OF_THIS_MACHINE
        found = await find_caller(self._service, scope)
        wait_s = self._service.rates.take(found.name) if found.role else self._service.strangers.take(address_of(scope))
        if wait_s:
            scope[CALLER] = found
            raise too_many("too many requests", wait_s)
        return found

    async def _check(self, scope: Scope, route: Asked | None) -> None:
        """Raises ProtocolError, NotFoundError."""
        caller = caller_of(scope)
        if route is None:
            raise _nothing_there(scope)
        if not caller.may(route.need):
            raise _may_not(caller, route)
        if route.changes and _is_of_another_page(scope, caller, route):
            raise ProtocolError(403, "cross-site", f"a page of another origin may not do that; pages send {PAGE_HEADER}: {PAGE}")
        if caller.owner is not None and isinstance(route.need, Right):
            await self._check_object(caller.owner.name, route.named)

    async def _check_object(self, owner: str, named: dict[str, str]) -> None:
        """What is another's is not there."""
        if (drive_id := named.get("drive_id")) is not None:
            await self._service.read(lambda session: owners.check_drive(session, drive_id, owner))
        if (upload_id := named.get("upload_id")) is not None:
            await self._service.read(lambda session: owners.check_upload(session, upload_id, owner))

    async def _note(self, scope: Scope, route: Asked, status: int) -> None:
        entry = _noted(scope, route, status, is_refused=status in REFUSED)
        is_of_strangers = route.template in BY_GET and entry.outcome != "done"  # any link brings these
        if route.template.startswith(UPLOADS) or entry.outcome == "refused" or is_of_strangers:
            self._service.trail.gather(entry)
        else:
            await self._service.trail.add(entry)


async def find_caller(service: Service, scope: Scope) -> Caller:
    """Who sends a request, by memory or by one indexed read. Raises ProtocolError where the database is away."""
    given = credential_of(Headers(scope=scope), scope.get("scheme") == "https")
    if given is None:
        return NOBODY
    held = service.callers.held(given)
    if held is not None:
        return held
    try:
        return await service.in_thread(lambda: service.callers.find(given))
    except DatabaseError:
        raise ProtocolError(503, "away", "the database does not answer: try again", {"Retry-After": "5"}) from None


def address_of(scope: Scope) -> str:
    """Where a request comes from; behind a proxy that is trusted, where that says."""
    client = scope.get("client")
    return str(client[0]) if client else "?"


def too_many(what: str, wait_s: float) -> ProtocolError:
    """429 with the time to wait."""
    return ProtocolError(429, "too-many", f"{what}: wait {wait_s:.0f} s", {"Retry-After": str(max(1, round(wait_s + 0.5)))})


def _may_not(caller: Caller, route: Asked) -> ProtocolError:
    if caller.role is None:
        return no_key()
    return ProtocolError(403, "forbidden", f"the role {caller.role} may not do that: it needs the right {route.need}")


def _nothing_there(scope: Scope) -> ProtocolError:
    methods = sorted(methods_of(scope["path"]))
    if methods:
        return ProtocolError(405, "method-not-allowed", f"here are {', '.join(methods)}", {"Allow": ", ".join(methods)})
    return ProtocolError(404, "not-found", "there is nothing at this address")


def _is_of_another_page(scope: Scope, caller: Caller, route: Asked) -> bool:
    """Whether a browser may have been made to send this change by a page that is not ours.

    Only what a browser adds by itself can be abused so: a cookie, or its being on this machine. A change by cookie needs the
    header that only our own pages can send; and no change comes from an origin that is not this host. What another site leads
    a browser to by its nature has its own proof that this browser asked for it, the `state` of OpenID Connect.
    """
    if route.template in BY_GET:
        return False
    headers = Headers(scope=scope)
    given = credential_of(headers, scope.get("scheme") == "https")
    if given is not None and not given.is_cookie:
        return False
    origin = headers.get("origin")
    if origin is not None and urlsplit(origin).netloc.lower() != headers.get("host", "").lower():
        return True
    return (caller.by_cookie or route.template == SESSION) and headers.get(PAGE_HEADER) != PAGE


def _noted(scope: Scope, route: Asked | None, status: int, is_refused: bool) -> Noted:
    caller = caller_of(scope)
    about: dict[str, Any] = {} if route is None or caller.role is None else route.named
    outcome = "refused" if is_refused else "done" if status < 400 else "failed"
    return Noted(
        at=time.time(), actor=caller.name, role=caller.role, action=f"{_method(scope)} {'?' if route is None else route.template}",
        object=scope.get(OBJECT) or " ".join(about.values()), address=address_of(scope), status=status, outcome=outcome,
    )  # fmt: skip


def _method(scope: Scope) -> str:
    method = str(scope["method"])
    return method if method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS") else "?"
