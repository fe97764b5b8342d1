"""Requests that are refused by their head alone: for another host than this one, or with two lengths."""

import ipaddress

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from wayloom.config.service import ServiceSettings
from wayloom_services.errors import problem


class CheckHead:
    """ASGI middleware.

    Where no key is wanted the service trusts whoever reaches it, so a page in a browser must not: under a name of the page's own
    that resolves to this machine (DNS rebinding) nothing is answered. A request with both Content-Length and Transfer-Encoding is
    one thing to a proxy and another to the server behind it.
    """

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self._app = app
        self._hosts = {name.strip().lower() for name in settings.allowed_hosts.split(",") if name.strip()}
        self._checks_hosts = bool(self._hosts) or not settings.is_closed
        self._own = settings.host.lower()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if "content-length" in headers and "transfer-encoding" in headers:
            said = "Content-Length and Transfer-Encoding exclude each other"
            await problem(400, "bad-header", said, {"Connection": "close"})(scope, receive, send)
        elif self._checks_hosts and not self._is_known(host_of(headers.get("host", ""))):
            said = "this service does not answer to that Host; name it in WAYLOOM_ALLOWED_HOSTS"
            await problem(421, "wrong-host", said)(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _is_known(self, host: str) -> bool:
        return host in self._hosts or host in ("localhost", self._own) or _is_loopback(host)


def host_of(header: str) -> str:
    """The name or address in a Host header, without port and brackets."""
    if header.startswith("["):
        return header[1:].partition("]")[0].lower()
    return header.partition(":")[0].lower()


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
