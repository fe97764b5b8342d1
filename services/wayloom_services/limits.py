"""Request size limits outside of uploads."""

import asyncio
from typing import Final

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wayloom.config.service import ServiceSettings
from wayloom_services.access.callers import caller_of
from wayloom_services.errors import problem

UPLOADS: Final = "/v1/uploads"
STRANGERS_BYTES: Final = 4096
"""Of a request whose sender is not known, as of one to sign in."""


class LimitBodies:
    """ASGI middleware, outside of the uploads: 413 for a body that is too long, announced or counted; 408 for one that stops."""

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self._app, self._settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http" or scope["path"].startswith(UPLOADS):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        most = STRANGERS_BYTES if caller_of(scope).role is None else self._settings.max_manifest_bytes
        too_large = f"a request here has at most {most} bytes"
        announced = headers.get("content-length", "")
        if announced.isdigit() and int(announced) > most:
            await problem(413, "too-large", too_large)(scope, receive, send)
            return
        come, is_coming = 0, True

        async def counted() -> Message:
            nonlocal come, is_coming
            try:
                async with asyncio.timeout(self._settings.body_pause_s if is_coming else None):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, "the body did not come in time", {"Connection": "close"}) from None
            is_coming = bool(message.get("more_body"))
            come += len(message.get("body", b""))
            if come > most:
                raise HTTPException(413, too_large)
            return message

        await self._app(scope, counted, send)
