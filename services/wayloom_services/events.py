"""Server-sent events of drives and maps. One poller reads the rows for all listeners, so events need no broker."""

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from functools import partial

import structlog
from fastapi import APIRouter, Depends, Request
from sse_starlette import EventSourceResponse, ServerSentEvent

from wayloom.store import drives, maps
from wayloom.store.database import DatabaseError, Session
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.views import drives_out

log = structlog.get_logger()
POLL_S = 0.7
WATCHED = 200
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
            self._last = await self._service.read(_snapshot)
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
                now, removed = await self._service.read(partial(_look, self._last))
            except DatabaseError as error:
                log.warning("events: database is away", error=str(error))
                continue
            for message in _changes(self._last, now, removed):
                for queue in list(self._listeners):
                    with suppress(asyncio.QueueFull):  # a listener that does not read gets the next state of each drive instead
                        queue.put_nowait(message)
            self._last = now


def _snapshot(session: Session) -> Snapshot:
    found = drives_out(session, drives.newest(session, WATCHED))
    snapshot = {("drive", drive.id): drive.model_dump_json() for drive in reversed(found)}
    versions = {("map", row.id): json.dumps({"id": row.id, "version": row.version}) for row in maps.all_maps(session)}
    return snapshot | versions


def _look(before: Snapshot, session: Session) -> tuple[Snapshot, list[str]]:
    """The current snapshot, and the drives of the last one that are removed; drives pushed off the list by newer ones are not."""
    after = _snapshot(session)
    unseen = sorted(drive_id for event, drive_id in before.keys() - after.keys() if event == "drive")
    known = drives.known(session, unseen)
    return after, [drive_id for drive_id in unseen if drive_id not in known]


def _changes(before: Snapshot, after: Snapshot, removed: Sequence[str]) -> list[ServerSentEvent]:
    gone = [ServerSentEvent(json.dumps({"id": drive_id}), event="removed") for drive_id in removed]
    return gone + [ServerSentEvent(data, event=key[0]) for key, data in after.items() if before.get(key) != data]


router = APIRouter(prefix="/v1", tags=["events"], dependencies=[Depends(require_key)])


@router.get("/events", response_class=EventSourceResponse, responses={200: {"content": {"text/event-stream": {}}}})
async def events(request: Request, _service: ServiceDep) -> EventSourceResponse:
    """Server-sent events: `drive` (as /v1/drives shows it), `removed` (id), `map` (id and version). First all, then changes."""
    feed: Feed = request.app.state.feed
    return EventSourceResponse(feed.listen(), ping=15)
