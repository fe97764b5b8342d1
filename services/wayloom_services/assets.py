"""Static files of the dashboard: compressed once, and cached for good under an address that holds the hash of their content.

A page is asked for anew each time, its scripts never again: wherever one of our files names `/static/…`, what is sent names
`/static/~HASH/…`, of the hash of all files together. The plain address stays for pages of others, and is asked for each time.
"""

import gzip
import hashlib
import mimetypes
import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from threading import Lock
from typing import Final

import anyio.to_thread
from starlette._utils import get_route_path
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

FOLDER: Final = Path(str(files("wayloom_services"))) / "static"
PAGES: Final = "pages"
TEXT: Final = frozenset({".js", ".mjs", ".css", ".html", ".svg", ".json", ".txt", ".md"})
REWRITTEN: Final = frozenset({".js", ".html"})
VENDOR: Final = "vendor"
NAMED: Final = re.compile(rb"""(["'`])/static/""")
FOR_GOOD: Final = "public, max-age=31536000, immutable"
EACH_TIME: Final = "no-cache"
LEAST_COMPRESSED: Final = 600


@dataclass(frozen=True, slots=True)
class Asset:
    """A file as it is sent: plain, compressed where that is worth it, its type and its tag."""

    plain: bytes
    compressed: bytes | None
    media_type: str
    tag: str


class Assets:
    """ASGI application of a folder of static files, which do not change while it runs."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self._folder = folder
        self._names = frozenset(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        digest = hashlib.sha256()
        for name in sorted(self._names):
            digest.update(name.encode() + b"\0" + (folder / name).read_bytes())
        self.prefix = f"~{digest.hexdigest()[:12]}"
        self._held: dict[str, Asset] = {}
        self._lock = Lock()

    async def page(self, name: str, request: Request, status: int = 200) -> Response:
        """A page by its name, asked for each time."""
        return await self._answer(f"{PAGES}/{name}.html", EACH_TIME, request, status)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request below the place where this is mounted. Raises HTTPException."""
        request = Request(scope)
        if request.method not in ("GET", "HEAD"):
            raise HTTPException(405, headers={"Allow": "GET, HEAD"})
        name = get_route_path(scope).lstrip("/")
        known = name.startswith(f"{self.prefix}/")
        if name.startswith("~"):
            name = name.partition("/")[2]
        answer = await self._answer(name, FOR_GOOD if known else EACH_TIME, request)
        await answer(scope, receive, send)

    async def _answer(self, name: str, keep: str, request: Request, status: int = 200) -> Response:
        if name not in self._names:
            raise HTTPException(404)
        asset = self._held.get(name)
        if asset is None:
            asset = await anyio.to_thread.run_sync(self._made, name)
        headers = {"ETag": asset.tag, "Cache-Control": keep, "Vary": "Accept-Encoding"}
        if status == 404:
            headers = {"Cache-Control": "no-store", "Vary": "Accept, Accept-Encoding"}
        elif asset.tag in [one.strip().removeprefix("W/") for one in request.headers.get("if-none-match", "").split(",")]:
            return Response(status_code=304, headers=headers)
        body = asset.plain
        if asset.compressed is not None and "gzip" in request.headers.get("accept-encoding", ""):
            body, headers["Content-Encoding"] = asset.compressed, "gzip"
        return Response(body, status, headers, asset.media_type)

    def _made(self, name: str) -> Asset:
        """The file as it is sent, made once: it takes some tens of milliseconds to compress one."""
        with self._lock:
            if name not in self._held:
                self._held[name] = self._read(name)
            return self._held[name]

    def _read(self, name: str) -> Asset:
        content, suffix = (self._folder / name).read_bytes(), Path(name).suffix
        if suffix in REWRITTEN and not name.startswith(f"{VENDOR}/"):
            content = NAMED.sub(rb"\1/static/" + self.prefix.encode() + b"/", content)
        packed = gzip.compress(content, 9, mtime=0) if suffix in TEXT and len(content) >= LEAST_COMPRESSED else None
        media_type = "text/javascript" if suffix in (".js", ".mjs") else mimetypes.guess_type(name)[0] or "application/octet-stream"
        return Asset(content, packed, media_type, f'"{hashlib.sha256(content).hexdigest()[:24]}"')
