"""HEAD of what maps are read by: answered as GET, without the body, which the server leaves out."""

from typing import Final

from starlette.types import ASGIApp, Receive, Scope, Send

MAPS: Final = "/v1/maps"


class HeadAsGet:
    """ASGI middleware: the routes of maps know GET alone."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, as a GET where it asks for the head of something of a map."""
        if scope["type"] != "http" or scope["method"] != "HEAD" or not scope["path"].startswith(MAPS):
            await self._app(scope, receive, send)
            return
        inner = dict(scope, method="GET")
        try:
            await self._app(inner, receive, send)
        finally:
            scope["route"] = inner.get("route")  # for the metrics, which count it as what it is
