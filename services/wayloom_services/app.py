"""ASGI application factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Final

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wayloom import __version__
from wayloom.config.service import ServiceSettings
from wayloom_services import (
    drive_results,
    drives,
    errors,
    events,
    excluded_areas,
    fleet,
    health,
    keyframes,
    lineage,
    maps,
    markings,
    ogc,
    packs,
    pages,
    regions,
    rigs,
    sync,
    tile_sets,
    tilesets,
    tus,
)
from wayloom_services.access import admin, sessions
from wayloom_services.access.guard import Guard
from wayloom_services.access.oidc import routes as oidc
from wayloom_services.archive import route as archive
from wayloom_services.context import make_service
from wayloom_services.events import Feed
from wayloom_services.heads import HeadAsGet
from wayloom_services.hosts import CheckHead
from wayloom_services.limits import LimitBodies
from wayloom_services.metrics import CountRequests
from wayloom_services.missing import MissingPages
from wayloom_services.openapi import describe
from wayloom_services.tile_answers import ShortWay
from wayloom_services.tus_headers import MethodOverride

CONTENT_SECURITY_POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; worker-src 'self'; connect-src 'self'; style-src 'self'; "
    "script-src 'self'; object-src 'none'; base-uri 'none'; frame-ancestors 'none'; form-action 'self'"
)

POLICY: Final = b"content-security-policy"
CORS: Final[dict[str, Any]] = {
    "allow_methods": ["GET", "HEAD"],
    "allow_headers": ["Authorization", "If-None-Match", "Range"],
    "expose_headers": ["ETag"],
    "max_age": 86_400,
}
"""What pages of allowed origins may do: read. There are no cookies; a page that has the key sends it as its own header."""


def create_app(settings: ServiceSettings) -> FastAPI:
    """The API, the tile server and the dashboard of one service."""
    service = make_service(settings)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        yield
        await service.trail.close()
        service.database.close()

    app = FastAPI(
        title="wayloom", version=__version__, lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url="/v1/openapi.json",
        description="Drives go in, a labelled, geo-referenced map comes out as tiles. Errors are problem+json (RFC 9457).",
    )  # fmt: skip
    app.state.service, app.state.feed = service, Feed(service)
    errors.install(app)
    uploads, people = (drives, drive_results, archive, keyframes, packs, tus), (sessions, oidc, admin, excluded_areas)
    of_maps = (maps, sync, markings, ogc, regions, tile_sets, tilesets, lineage, rigs, fleet, events, health)
    for room in (*uploads, *of_maps, *people):
        app.include_router(room.router)
    app.include_router(pages.router)
    app.mount("/static", pages.assets(), name="static")
    describe(app)
    app.add_middleware(ShortWay, service=service)
    app.add_middleware(HeadAsGet)
    app.add_middleware(LimitBodies, settings=settings)
    app.add_middleware(Guard, service=service)
    app.add_middleware(MissingPages)
    app.add_middleware(CheckHead, settings=settings)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(MethodOverride)
    if settings.cors_origins:
        app.add_middleware(CORSMiddleware, allow_origins=settings.cors_origins, **CORS)
    app.add_middleware(CountRequests, metrics=service.metrics)
    return app


class SecurityHeaders:
    """ASGI middleware: what a browser may load, and that it must not guess types."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                own_policy = any(name.lower() == POLICY for name, _ in message["headers"])  # of a report that stands by itself
                message["headers"] = [
                    *message["headers"],
                    *([] if own_policy else [(POLICY, CONTENT_SECURITY_POLICY.encode())]),
                    (b"x-content-type-options", b"nosniff"),
                    (b"referrer-policy", b"no-referrer"),
                ]
            await send(message)

        await self._app(scope, receive, with_headers if scope["type"] == "http" else send)
