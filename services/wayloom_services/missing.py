"""Pages for what is not there: a browser gets one that says so with the status 404, programs keep the problem document."""

import re
from typing import Final

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wayloom_services.pages import assets

OF_PROGRAMS: Final = frozenset({"v1", "static"})
"""First parts of paths that no person types."""
OF_A_DRIVE: Final = re.compile(r"/drives/[^/]+")


class MissingPages:
    """ASGI middleware.

    A drive's page says itself that there is no such drive: an id that is well-formed is looked up by the page alone, so one that
    is not gets the same page.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; where it is a browser's and the answer is 404, send the page in its place."""
        if not _is_of_a_browser(scope):
            await self._app(scope, receive, send)
            return
        is_missing = False

        async def or_page(message: Message) -> None:
            nonlocal is_missing
            if message["type"] == "http.response.start" and message["status"] == 404:
                is_missing = True
                name = "drive" if OF_A_DRIVE.fullmatch(scope["path"]) else "missing"
                answer = await assets().page(name, Request(scope), status=404)
                await answer(scope, receive, send)
            elif not is_missing:
                await send(message)

        await self._app(scope, receive, or_page)


def _is_of_a_browser(scope: Scope) -> bool:
    """Whether somebody looks at a page: what asks for no HTML is a program."""
    if scope["type"] != "http" or scope["method"] not in ("GET", "HEAD"):
        return False
    if scope["path"].lstrip("/").partition("/")[0] in OF_PROGRAMS:
        return False
    return "text/html" in Headers(scope=scope).get("accept", "")
