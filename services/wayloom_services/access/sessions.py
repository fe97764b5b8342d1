"""Endpoints of the operators' sign-in: a session in the database, its token in a cookie that no script reads."""

from dataclasses import dataclass
from typing import Final

import anyio.to_thread
from fastapi import APIRouter, Depends, Request, Response

from wayloom.config.roles import RIGHTS, Role
from wayloom.store.access import users
from wayloom.store.access.passwords import is_right
from wayloom.store.database import Session, now_s
from wayloom_services.access.callers import COOKIE, COOKIE_OF_HTTPS, caller_of
from wayloom_services.access.guard import OBJECT, address_of, too_many
from wayloom_services.access.needs import SESSION
from wayloom_services.access.schemas import Me, SignIn
from wayloom_services.context import ServiceDep, require_key
from wayloom_services.errors import Problem, ProtocolError, no_key

router = APIRouter(prefix=SESSION, tags=["access"], dependencies=[Depends(require_key)])

WRONG: Final = "name or password is wrong; after some wrong ones the right one has to wait too, five minutes at most"
"""Of a user who has to wait the same, so that nobody learns which names there are."""


@dataclass(frozen=True, slots=True)
class _Tried:
    """The end of a try to sign in: the token of the new session, or none."""

    role: Role | None = None
    token: str | None = None


@router.get("")
async def who(request: Request) -> Me:
    """Who the caller is, by its key or its session, and what it may do."""
    caller = caller_of(request.scope)
    if caller.role is None:
        raise no_key()
    return _me(caller.name, caller.role, caller.by_cookie)


@router.post("", responses={401: {"model": Problem, "description": "name or password is wrong, or has to wait"}})
async def sign_in(wanted: SignIn, request: Request, response: Response, service: ServiceDep) -> Me:
    """Begin a session: the answer sets its cookie. 401 where name or password is wrong, and for a while after some of these;
    429 where too many come from an address."""
    address, settings = address_of(request.scope), service.settings.access
    if wait_s := service.sign_ins.take(address):
        raise too_many("too many sign-ins from this address", wait_s)
    kept = await service.read(lambda session: _password_of(session, wanted.name))
    if kept is not None:
        request.scope[OBJECT] = f"user {wanted.name}"
    right = await anyio.to_thread.run_sync(is_right, wanted.password, kept, limiter=service.hashing)
    cookie = cookie_name(request)
    brought = request.cookies.get(cookie)

    def change(session: Session) -> _Tried:
        return _tried(session, wanted.name, right, address, settings.session_s, brought)

    tried = await service.write(change)
    if tried.token is None or tried.role is None:
        raise ProtocolError(401, "wrong-sign-in", WRONG)
    service.callers.forget()
    keep_signed_in(request, response, tried.token, settings.session_s)
    return _me(f"user {wanted.name}", tried.role, True)


@router.delete("", status_code=204)
async def sign_out(request: Request, service: ServiceDep) -> Response:
    """End the caller's session; of a caller with a key there is none."""
    cookie = cookie_name(request)
    token = request.cookies.get(cookie)
    if token is not None:
        await service.write(lambda session: users.sign_out(session, token))
        service.callers.forget()
    answer = Response(status_code=204)
    answer.delete_cookie(cookie, path="/", secure=cookie == COOKIE_OF_HTTPS, httponly=True, samesite="strict")
    return answer


def keep_signed_in(request: Request, response: Response, token: str, session_s: float) -> None:
    """Have the browser keep the token of a new session, where no script reads it and no other site uses it."""
    name = cookie_name(request)
    response.set_cookie(
        name, token, max_age=int(session_s), path="/", secure=name == COOKIE_OF_HTTPS, httponly=True, samesite="strict"
    )


def cookie_name(request: Request) -> str:
    """What the session's cookie is called on the way that the request came."""
    return COOKIE_OF_HTTPS if request.url.scheme == "https" else COOKIE


def _password_of(session: Session, name: str) -> str | None:
    user = users.named(session, name)
    return None if user is None else user.password


def _tried(session: Session, name: str, right: bool, address: str, session_s: float, brought: str | None) -> _Tried:
    """Count a wrong password or begin a session. While a user is blocked the right password is no better than a wrong one: of
    guesses that come at once the later ones find it blocked too."""
    user = users.held(session, name)
    if user is None or (user.blocked_until is not None and user.blocked_until > now_s(session)):
        return _Tried()
    if not right:
        users.note_failure(session, user)
        return _Tried()
    if brought is not None:
        users.sign_out(session, brought)
    return _Tried(Role(user.role), users.sign_in(session, user, address, session_s))


def _me(name: str, role: Role, signed_in: bool) -> Me:
    return Me(name=name, role=role, rights=sorted(RIGHTS[role]), signed_in=signed_in)
