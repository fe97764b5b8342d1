"""Server-sent events of drives and maps. One poller reads the rows for all listeners, so events need no broker."""

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from functools import partial

import structlog
from fastapi import APIRouter, Depends, Request
from sse_starlette import EventSourceResponse, ServerSentEvent

from wayloom.store import drives, map_versions, maps
from wayloom.store.database import DatabaseError, Session
from wayloom.store.tables.maps import TileRow
from wayloom_services.access.streams import stream_for
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.etas import Past
from wayloom_services.views import drives_out

log = structlog.get_logger()
POLL_S = 0.7
WATCHED = 200
NAMED_TILES = 5000
"""Most tiles that an event names; of more there is `versions/{n}/changes`."""
Snapshot = dict[tuple[str, str], str]
"""(event, id) -> the event's data. Of the drives only the WATCHED newest."""


class Feed:
    """Polls the newest drives and the maps while anybody listens, and broadcasts the changes to all listeners."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._last: Snapshot = {}
        self._listeners: set[asyncio.Queue[ServerSentEvent]] = set()
        self._poller: asyncio.Task[None] | None = None

    async def listen(self) -> AsyncIterator[ServerSentEvent]:
        """First everything as it is, then every change."""
        queue: asyncio.Queue[ServerSentEvent] = asyncio.Queue(maxsize=10_000)
        if not self._listeners:
            self._last = await self._service.read(partial(_snapshot, self._service.past))
        for (event, _), data in self._last.items():
            queue.put_nowait(ServerSentEvent(data, event=event))
        self._listeners.add(queue)
        if self._poller is None or self._poller.done():
            self._poller = asyncio.create_task(self._poll())
        try:
            while True:
                yield await queue.get()
        finally:
            self._listeners.discard(queue)

    async def _poll(self) -> None:
        while self._listeners:
            await asyncio.sleep(POLL_S)
            try:
                now, removed, published = await self._service.read(partial(_look, self._service.past, self._last))
            except DatabaseError as error:
                log.warning("events: database is away", error=str(error))
                continue
            for message in [*_changes(self._last, now, removed), *published]:
                for queue in list(self._listeners):
                    with suppress(asyncio.QueueFull):  # a listener that does not read gets the next state of each drive instead
                        queue.put_nowait(message)
            self._last = now


def _snapshot(past: Past, session: Session) -> Snapshot:
    found = drives_out(session, drives.newest(session, WATCHED), past)
    snapshot = {("drive", drive.id): drive.model_dump_json() for drive in reversed(found)}
    versions = {("map", row.id): json.dumps({"id": row.id, "version": row.version}) for row in maps.all_maps(session)}
    return snapshot | versions


def _look(past: Past, before: Snapshot, session: Session) -> tuple[Snapshot, list[str], list[ServerSentEvent]]:
    """The current snapshot; the drives of the last one that are removed (those pushed off the list by newer ones are not); and of
    each version that was published since the tiles that it changed."""
    after = _snapshot(past, session)
    unseen = sorted(drive_id for event, drive_id in before.keys() - after.keys() if event == "drive")
    known = drives.known(session, unseen)
    published = [
        message
        for (event, map_id), data in after.items()
        if event == "map" and before.get((event, map_id)) not in (None, data)
        for message in _published(session, map_id, _version(before[event, map_id]) + 1, _version(data))
    ]
    return after, [drive_id for drive_id in unseen if drive_id not in known], published


def _version(data: str) -> int:
    return int(json.loads(data)["version"])


def _published(session: Session, map_id: str, first: int, last: int) -> list[ServerSentEvent]:
    """For each of the versions that are served, its event `tiles`."""
    served = [row.version for row in maps.versions(session, map_id) if first <= row.version <= last]
    return [ServerSentEvent(json.dumps(_named(session, map_id, number)), event="tiles") for number in sorted(served)]


def _named(session: Session, map_id: str, number: int) -> dict[str, object]:
    """The tiles that a version changed, by layer; of very many only how many."""
    new, gone = map_versions.changes(session, map_id, number)
    about = {"map": map_id, "version": number, "count": len(new) + len(gone), "whole": len(new) + len(gone) <= NAMED_TILES}
    return about | {"changed": _by_layer(new if about["whole"] else ()), "gone": _by_layer(gone if about["whole"] else ())}


def _by_layer(rows: Sequence[TileRow]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for row in rows:
        found.setdefault(row.layer, []).append(f"{row.z}/{row.x}/{row.y}")
    return found


def _changes(before: Snapshot, after: Snapshot, removed: Sequence[str]) -> list[ServerSentEvent]:
    gone = [ServerSentEvent(json.dumps({"id": drive_id}), event="removed") for drive_id in removed]
    return gone + [ServerSentEvent(data, event=key[0]) for key, data in after.items() if before.get(key) != data]


router = APIRouter(prefix="/v1", tags=["events"], dependencies=[Depends(require_key)])


@router.get("/events", response_class=EventSourceResponse, responses={200: {"content": {"text/event-stream": {}}}})
async def events(request: Request, service: ServiceDep) -> EventSourceResponse:
    """Server-sent events: `drive` (as /v1/drives shows it), `removed` (id), both of the 200 drives that were announced last, and
    `map` (id and version): first all, then changes. Then also `tiles`, for each version that is published: `map`, `version`, the
    tiles that it `changed` and those `gone`, by layer as "z/x/y", and their `count`; of more than 5000 none is named, `whole` is
    false, and `versions/{n}/changes` has them. A vehicle hears of its own drives alone. The stream ends soon after its key or
    session does."""
    feed: Feed = request.app.state.feed
    return EventSourceResponse(stream_for(request, service, feed.listen()), ping=15)
