"""Headers of the tus protocol: parsing and formatting."""

import base64
import binascii
import hashlib
from email.utils import formatdate
from typing import Final

from fastapi import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from wayloom_services.errors import ProtocolError

VERSION: Final = "1.0.0"
EXTENSIONS: Final = "creation,creation-with-upload,checksum,expiration,termination"
CONTENT_TYPE: Final = "application/offset+octet-stream"
CHECKSUMS: Final = {"sha1": hashlib.sha1, "sha256": hashlib.sha256}


def check_version(request: Request) -> None:
    """Refuse another version of the protocol."""
    if request.headers.get("tus-resumable") != VERSION:
        raise ProtocolError(412, "wrong-version", f"Tus-Resumable must be {VERSION}", {"Tus-Version": VERSION})


def integer(request: Request, name: str) -> int:
    """A header that is a number of bytes."""
    text = request.headers.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) <= 16):
        raise ProtocolError(400, "bad-header", f"{name} must be a number of bytes")
    return int(text)


def metadata(header: str) -> dict[str, str]:
    """Upload-Metadata: comma-separated pairs of a key and its value in base64."""
    found = {}
    for pair in filter(None, (part.strip() for part in header.split(","))):
        key, _, value = pair.partition(" ")
        try:
            found[key] = base64.b64decode(value, validate=True).decode()
        except (binascii.Error, UnicodeDecodeError):
            raise ProtocolError(400, "bad-header", f"Upload-Metadata: the value of {key[:40]!r} is not base64 of UTF-8") from None
    return found


def checksum(request: Request) -> tuple[str, bytes] | None:
    """Upload-Checksum: the algorithm and the digest in base64."""
    header = request.headers.get("upload-checksum")
    if header is None:
        return None
    algorithm, _, digest = header.partition(" ")
    if algorithm not in CHECKSUMS:
        raise ProtocolError(400, "unknown-checksum", f"Upload-Checksum: {algorithm[:40]!r} is none of {', '.join(CHECKSUMS)}")
    try:
        return algorithm, base64.b64decode(digest, validate=True)
    except binascii.Error:
        raise ProtocolError(400, "bad-header", "Upload-Checksum: the digest is not base64") from None


def date(seconds: float) -> str:
    """Seconds since 1970 as an HTTP date."""
    return formatdate(seconds, usegmt=True)


class MethodOverride:
    """ASGI middleware: a client that cannot send PATCH, DELETE or HEAD says so in X-HTTP-Method-Override, as the protocol asks."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] == "http" and scope["method"] == "POST" and scope["path"].startswith("/v1/uploads/"):
            wanted = dict(scope["headers"]).get(b"x-http-method-override", b"POST").decode("latin-1").upper()
            scope["method"] = wanted if wanted in ("PATCH", "DELETE", "HEAD") else "POST"
        await self._app(scope, receive, send)
