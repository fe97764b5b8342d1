"""Endpoints of the sign-in by an OpenID provider: to it, and back from it to a session like that of a password."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import RedirectResponse

from wayloom.store.access import provided, users
from wayloom.store.access.secrets import is_same
from wayloom.store.database import Session
from wayloom_services.access.guard import OBJECT, address_of, too_many
from wayloom_services.access.needs import OIDC, OIDC_CALLBACK
from wayloom_services.access.oidc.pages import refusal
from wayloom_services.access.sessions import cookie_name, keep_signed_in
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.errors import ProtocolError

if TYPE_CHECKING:
    from wayloom_services.access.oidc.provider import Provider

router = APIRouter(tags=["access"], dependencies=[Depends(require_key)])

LASTS_S: Final = 600
"""How long a browser keeps what it needs to come back."""
Text = Annotated[str | None, Query(max_length=4096)]
Next = Annotated[str, Query(alias="next", max_length=4096)]
Answers = dict[int | str, dict[str, Any]]
ANSWERS: Final[Answers] = {
    404: {"description": "this service has no OpenID provider"},
    503: {"description": "the OpenID provider does not answer as it should: Retry-After says when it may be tried again"},
}
REFUSALS: Final[Answers] = {
    **ANSWERS,
    403: {"description": "state, code or ID token is not good, the provider gives no role, or the user is disabled"},
    409: {"description": "another user has the name that this one would get"},
}
NO_ROLE: Final = "the provider gives you no role on this service: ask its administrator for one"
DISABLED: Final = "you are disabled on this service: ask its administrator"


@dataclass(frozen=True, slots=True)
class _End:
    """The end of a sign-in: the user's name, and the token of the new session or why there is none."""

    name: str | None
    token: str | None = None
    refused: str = ""


@router.get(OIDC, status_code=303, response_class=RedirectResponse, responses=ANSWERS)
async def go(request: Request, service: ServiceDep, wanted: Next = "/") -> Response:
    """Send the browser to the OpenID provider. next: path of this service where it shall be at the end; any other is `/`."""
    try:
        address, cookie = await _provider(service, request).begin(wanted, _back(request))
    except ProtocolError as error:
        return refusal(request, error)
    answer = _redirect(address)
    name = _cookie_name(request)
    answer.set_cookie(name, cookie, max_age=LASTS_S, path="/", secure=name.startswith("__Host-"), httponly=True, samesite="lax")
    return answer


@router.get(OIDC_CALLBACK, status_code=303, response_class=RedirectResponse, responses=REFUSALS)
async def come_back(
    request: Request, service: ServiceDep, code: Text = None, state: Text = None, error: Text = None, iss: Text = None
) -> Response:
    """Begin a session for whom the OpenID provider has signed in: the answer sets its cookie and leads to the page asked for."""
    try:
        provider = _provider(service, request)
        answer = await _ended(request, service, provider, code, state, error, iss)
    except ProtocolError as refused:
        answer = refusal(request, refused)
    name = _cookie_name(request)
    answer.delete_cookie(name, path="/", secure=name.startswith("__Host-"), httponly=True, samesite="lax")
    return answer


async def _ended(
    request: Request,
    service: Service,
    provider: "Provider",
    code: str | None,
    state: str | None,
    error: str | None,
    iss: str | None,
) -> Response:
    """Raises ProtocolError."""
    pending = provider.pending(request.cookies.get(_cookie_name(request)))
    if pending is None or not is_same(state or "", pending.state):
        said = "this sign-in was not begun by this browser, is over already, or took longer than ten minutes: begin anew"
        raise ProtocolError(403, "wrong-state", said)
    if iss is not None and iss != provider.issuer:  # RFC 9207
        raise ProtocolError(403, "wrong-issuer", "another provider answers than the one that was asked")
    if code is None:
        what = error if error is not None and re.fullmatch(r"[a-z_]{1,40}", error) else "no code"
        raise ProtocolError(403, "refused-by-provider", f"the provider did not sign you in: {what}")
    claims = await provider.claims(code, pending, _back(request))
    request.scope[OBJECT] = f"subject {_printable(claims['sub'])}"
    token = await _begun(request, service, provider, claims)
    answer = _redirect(pending.next)
    keep_signed_in(request, answer, token, service.settings.access.session_s)
    return answer


async def _begun(request: Request, service: Service, provider: "Provider", claims: Mapping[str, Any]) -> str:
    """The token of a new session. Raises ProtocolError where the user has no role or is disabled."""
    address, brought = address_of(request.scope), request.cookies.get(cookie_name(request))
    end = await service.write(lambda session: _signed_in(session, provider, claims, address, brought))
    service.callers.forget()
    if end.name is not None:
        request.scope[OBJECT] = f"user {end.name}"
    if end.token is None:
        raise ProtocolError(403, "forbidden", end.refused)
    return end.token


def _signed_in(session: Session, provider: "Provider", claims: Mapping[str, Any], address: str, brought: str | None) -> _End:
    """Renew the user's row and begin a session."""
    role = provider.role(claims)
    user = provided.renewed(session, provider.issuer, claims["sub"], provider.called(claims), role)
    if user is None:
        return _End(None, refused=NO_ROLE)
    if users.is_disabled(user):
        return _End(user.name, refused=DISABLED)
    if brought is not None:
        users.sign_out(session, brought)
    return _End(user.name, users.sign_in(session, user, address, provider.settings.session_s))


def _provider(service: Service, request: Request) -> "Provider":
    """Raises ProtocolError: 404 where there is no provider, 429 where too many sign-ins come from an address."""
    if service.oidc is None:
        raise ProtocolError(404, "not-found", "this service has no OpenID provider")
    if wait_s := service.sign_ins.take(address_of(request.scope)):
        raise too_many("too many sign-ins from this address", wait_s)
    return service.oidc


def _back(request: Request) -> str:
    """The address of the way back as the browser sees this service; the provider knows it and compares it letter by letter."""
    return f"{request.url.scheme}://{request.url.netloc}{OIDC_CALLBACK}"


def _cookie_name(request: Request) -> str:
    return "__Host-wayloom-oidc" if request.url.scheme == "https" else "wayloom-oidc"


def _redirect(address: str) -> Response:
    return RedirectResponse(address, 303, {"Cache-Control": "no-store"})


def _printable(text: str) -> str:
    return "".join(letter for letter in text if letter.isprintable())[:200]
