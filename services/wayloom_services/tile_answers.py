"""Answers to requests for tiles, and the short way to them: well-formed addresses do not go through the routes of the API.

What a tile costs is one look-up by primary keys and at most one blob, in one of the service's threads. An address that this way
does not take, because it is malformed, goes on to the routes (`maps`), which answer alike and say what is wrong with it.
"""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Final

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from wayloom.errors import WayloomError
from wayloom.store.tile_reads import FoundTile
from wayloom.tiles.descriptions import LARGE_LAYERS
from wayloom.tiles.formats import SERVED_LAYERS
from wayloom.tiles.png import joined_png
from wayloom_services.context import Service
from wayloom_services.errors import ProtocolError, answer_to

ASK_AGAIN: Final = "no-cache"
FINEST_ZOOM: Final = 24
ROUTE: Final = "/v1/maps/{map_id}/tiles/{layer}/{z}/{x}/{y}.{ext}"
ROUTE_OF_VERSION: Final = "/v1/maps/{map_id}/versions/{number}/tiles/{layer}/{z}/{x}/{y}.{ext}"
PATH: Final = re.compile(
    r"/v1/maps/([a-z0-9][a-z0-9-]{0,62})(?:/versions/([1-9][0-9]{0,8}))?"
    r"/tiles/([a-z0-9][a-z0-9_-]{0,31})/([0-9]{1,2})/([0-9]{1,8})/([0-9]{1,8})(@2x)?\.[a-z0-9]{1,8}"
)


@dataclass(frozen=True, slots=True)
class TileAsked:
    """Which tile: map, version (None: the newest), layer and address; large: in 512 pixels, of a layer whose tiles have 256."""

    map_id: str
    number: int | None
    layer: str
    z: int
    x: int
    y: int
    large: bool = False


async def tile_answer(service: Service, headers: Headers, asked: TileAsked) -> Response:
    """200 with the tile, 304 where the client has it, 204 where nothing is mapped. Raises ProtocolError for what cannot be."""
    edge = 1 << asked.z
    if asked.x >= edge or asked.y >= edge:
        raise ProtocolError(404, "not-found", f"zoom {asked.z} has no tile {asked.x}/{asked.y}: both go from 0 to {edge - 1}")
    if asked.large and asked.layer not in LARGE_LAYERS:
        raise ProtocolError(404, "not-found", f"layer {asked.layer!r} has no tiles @2x; {', '.join(LARGE_LAYERS)} have")
    cache = ASK_AGAIN if asked.number is None else forever(service)
    if asked.layer not in SERVED_LAYERS:
        return Response(status_code=204, headers={"Cache-Control": cache})
    return await service.in_thread(lambda: _looked_up(service, headers, asked, cache))


def _looked_up(service: Service, headers: Headers, asked: TileAsked, cache: str) -> Response:
    size = 2 if asked.large else 1
    place = asked.z + asked.large, asked.x * size, asked.y * size
    found = service.tiles.tiles(asked.map_id, asked.number, asked.layer, *place, size)
    if not found:
        return Response(status_code=204, headers={"Cache-Control": cache})
    tag = _tag_of(found) if asked.large else found[0].digest
    known = {"ETag": f'"{tag}"', "Cache-Control": cache}
    if is_held(headers, tag):
        return Response(status_code=304, headers=known)
    content = service.held.made(tag, lambda: _joined(service, found)) if asked.large else service.held.get(tag)
    return Response(content, headers=known, media_type=found[0].media_type)


def _tag_of(four: Sequence[FoundTile]) -> str:
    """Of a large picture: known before it is drawn."""
    return hashlib.sha256(repr(sorted((one.x & 1, one.y & 1, one.digest) for one in four)).encode()).hexdigest()


def _joined(service: Service, four: Sequence[FoundTile]) -> bytes:
    return joined_png({(one.x & 1, one.y & 1): service.held.get(one.digest) for one in four})


def is_held(headers: Headers, tag: str) -> bool:
    """Whether the client says that it has what has this tag."""
    given = headers.get("if-none-match")
    return given is not None and any(one.strip().removeprefix("W/").strip('"') in (tag, "*") for one in given.split(","))


def forever(service: Service) -> str:
    """Cache-Control of what never changes; what only the bearer of a key may have is kept by a browser, not by a proxy for all."""
    return f"{'private' if service.settings.is_closed else 'public'}, max-age=31536000, immutable"


class ShortWay:
    """ASGI middleware that answers requests for tiles, and passes on all others. The guard before it has let them through."""

    def __init__(self, app: ASGIApp, service: Service) -> None:
        self._app, self._service = app, service
        self._routes = SimpleNamespace(path=ROUTE), SimpleNamespace(path=ROUTE_OF_VERSION)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        asked = _asked(scope)
        if asked is None:
            await self._app(scope, receive, send)
            return
        scope["route"] = self._routes[asked.number is not None]
        headers = Headers(scope=scope)
        try:
            answer = await tile_answer(self._service, headers, asked)
        except WayloomError as error:
            answer = answer_to(error)
        await answer(scope, receive, send)


def _asked(scope: Scope) -> TileAsked | None:
    if scope["type"] != "http" or scope["method"] != "GET":
        return None
    match = PATH.fullmatch(scope["path"])
    if match is None or int(match[4]) > FINEST_ZOOM:
        return None
    map_id, number, layer, z, x, y, large = match.groups()
    return TileAsked(map_id, int(number) if number else None, layer, int(z), int(x), int(y), large is not None)
