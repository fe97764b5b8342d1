"""Mapping of wayloom's errors to HTTP: problem+json (RFC 9457) with a stable code, by one table."""

from typing import Final

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from wayloom import errors
from wayloom.store.access.quotas import QuotaError
from wayloom.store.blobs import BlobError
from wayloom.store.database import DatabaseAwayError
from wayloom.store.manifest_text import ManifestTextError, TooManyFilesError

log = structlog.get_logger()
MEDIA_TYPE: Final = "application/problem+json"


class ProtocolError(errors.WayloomError):
    """A request that breaks the rules of the upload protocol, or cannot be served now. Carries its own status and code."""

    def __init__(self, status: int, code: str, detail: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status, self.code, self.headers = status, code, headers or {}


STATUS_OF: Final[dict[type[errors.WayloomError], int]] = {
    errors.NotFoundError: 404,
    errors.WithdrawnError: 410,
    errors.OffsetConflictError: 409,
    errors.ConflictError: 409,
    errors.ChecksumMismatchError: 460,
    errors.LeaseLostError: 409,
    TooManyFilesError: 413,
    QuotaError: 429,
    errors.ConfigError: 500,
    errors.MissingExtraError: 500,
    errors.InputError: 400,
    errors.StageError: 500,
    errors.ServiceError: 502,
    errors.WayloomError: 500,
}
"""The nearest class in an error's ancestry decides."""

CODE_OF_STATUS: Final = {
    400: "bad-request",
    401: "unauthorized",
    403: "forbidden",
    404: "not-found",
    408: "too-slow",
    405: "method-not-allowed",
    413: "too-large",
    422: "malformed-request",
}


class Problem(BaseModel):
    """The body of every error."""

    type: str = "about:blank"
    title: str
    status: int
    code: str
    detail: str
    errors: list[dict[str, str]] | None = None


def problem(status: int, code: str, detail: str, headers: dict[str, str] | None = None, **more: object) -> JSONResponse:
    """The response."""
    body = {
        "type": "about:blank",
        "title": code.replace("-", " ").capitalize(),
        "status": status,
        "code": code,
        "detail": detail,
        **more,
    }
    return JSONResponse(body, status, headers, MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Make every error of the application a problem."""
    app.add_exception_handler(errors.WayloomError, _wayloom)
    app.add_exception_handler(ManifestTextError, _no_manifest)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _malformed)
    app.add_exception_handler(DatabaseAwayError, _away)
    app.add_exception_handler(BlobError, _away)
    app.add_exception_handler(Exception, _unforeseen)


def no_key() -> ProtocolError:
    """The error of a request whose sender is not known."""
    said = "this server wants a key as a Bearer token, or a sign-in; none came, or one that is unknown, expired or revoked"
    return ProtocolError(401, "unauthorized", said, {"WWW-Authenticate": "Bearer"})


async def _wayloom(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, errors.WayloomError)
    return answer_to(error)


def answer_to(error: errors.WayloomError) -> JSONResponse:
    """The response to an error of ours."""
    if isinstance(error, ProtocolError):
        return problem(error.status, error.code, str(error), error.headers)
    status = next(STATUS_OF[kind] for kind in type(error).__mro__ if kind in STATUS_OF)
    headers = {"Retry-After": f"{error.after_s:.0f}"} if isinstance(error, QuotaError) else None
    return problem(status, error.code, str(error), headers)


async def _no_manifest(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, ManifestTextError)
    return problem(422, error.code, str(error), errors=error.found)


async def _http(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    code = CODE_OF_STATUS.get(error.status_code, "error")
    return problem(error.status_code, code, str(error.detail), dict(error.headers or {}))


async def _malformed(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    found = [{"where": ".".join(str(part) for part in one["loc"]), "what": str(one["msg"])} for one in error.errors()[:20]]
    first = found[0] if found else {"where": "request", "what": "malformed"}
    return problem(422, "malformed-request", f"{first['where']}: {first['what']}", errors=found)


async def _away(request: Request, error: Exception) -> JSONResponse:
    what = "database" if isinstance(error, DatabaseAwayError) else "object store"
    log.warning("a part of the service is away", what=what, path=request.url.path, error=str(error))
    return problem(503, "away", f"the {what} does not answer: try again", {"Retry-After": "5"})


async def _unforeseen(request: Request, error: Exception) -> JSONResponse:
    log.error("request failed", path=request.url.path, method=request.method, exc_info=error)
    return problem(500, "internal-error", "the server made a mistake; its log says more")
