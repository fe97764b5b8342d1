"""Headers of the tus protocol, and of the pieces that wayloom adds to it: parsing and formatting."""

import base64
import binascii
import hashlib
import struct
from email.utils import formatdate
from typing import Final

from fastapi import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from wayloom.store.arrivals import Pieces
from wayloom_services.errors import ProtocolError

VERSION: Final = "1.0.0"
EXTENSIONS: Final = "creation,creation-with-upload,checksum,expiration,termination"
CONTENT_TYPE: Final = "application/offset+octet-stream"
CHECKSUMS: Final = {"sha1": hashlib.sha1, "sha256": hashlib.sha256}

PIECES: Final = "crc32"
"""What `Upload-Pieces` gives of each piece."""
LEAST_PIECE: Final = 4096
LARGEST_PIECE: Final = 4 << 20
"""A piece waits in memory until it is whole."""


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


def pieces(request: Request) -> Pieces | None:
    """Upload-Pieces: `crc32`, the size of a piece, and the big-endian CRC-32 of each piece of the body, together in base64."""
    header = request.headers.get("upload-pieces")
    if header is None:
        return None
    kind, size, sums = (*header.split(" "), "", "")[:3]
    if kind != PIECES or not (size.isascii() and size.isdigit() and len(size) <= 8):
        raise ProtocolError(400, "unknown-checksum", f"Upload-Pieces: write {PIECES}, a piece's bytes, their sums in base64")
    if not LEAST_PIECE <= int(size) <= LARGEST_PIECE:
        raise ProtocolError(400, "bad-header", f"Upload-Pieces: a piece has {LEAST_PIECE} to {LARGEST_PIECE} bytes")
    try:
        content = base64.b64decode(sums, validate=True)
    except binascii.Error:
        raise ProtocolError(400, "bad-header", "Upload-Pieces: the sums are not base64") from None
    if len(content) % 4:
        raise ProtocolError(400, "bad-header", "Upload-Pieces: a sum has 4 bytes")
    return Pieces(int(size), struct.unpack(f">{len(content) // 4}I", content))


def date(seconds: float) -> str:
    """Seconds since 1970 as an HTTP date."""
    return formatdate(seconds, usegmt=True)


class MethodOverride:
    """ASGI middleware: a client that cannot send PATCH, DELETE or HEAD says so in X-HTTP-Method-Override, as the protocol asks."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on. The server below goes by the method that was sent: to a POST it sends the body of an answer."""
        inner = scope
        if scope["type"] == "http" and scope["method"] == "POST" and scope["path"].startswith("/v1/uploads/"):
            wanted = dict(scope["headers"]).get(b"x-http-method-override", b"POST").decode("latin-1").upper()
            inner = dict(scope, method=wanted if wanted in ("PATCH", "DELETE", "HEAD") else "POST")
        try:
            await self._app(inner, receive, send)
        finally:
            if "route" in inner:
                scope["route"] = inner["route"]  # for the metrics
