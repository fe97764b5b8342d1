"""Trail of changes and refusals on its way to the audit log: many entries by one transaction."""

import asyncio
from contextlib import suppress
from dataclasses import replace

import structlog

from wayloom.store.access.audit import Noted, append
from wayloom.store.database import Database, DatabaseError

log = structlog.get_logger()
GATHER_S = 1.0
"""How long entries that nobody waits for are gathered."""
MOST_GATHERED = 10_000
"""Of different ones; what is more is told in the process's log."""


class Trail:
    """Writes entries of the audit log. To be used in one event loop."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._awaited: list[tuple[Noted, asyncio.Future[None]]] = []
        self._gathered: dict[Noted, tuple[float, int]] = {}
        self._is_awaited = asyncio.Event()
        self._writer: asyncio.Task[None] | None = None

    async def add(self, entry: Noted) -> None:
        """Return when the entry is committed; entries that come meanwhile share the next transaction. Where the database is away
        the entry goes to the process's log instead."""
        written = asyncio.get_running_loop().create_future()
        self._awaited.append((entry, written))
        self._is_awaited.set()
        self._begin()
        await written

    def gather(self, entry: Noted) -> None:
        """Have the entry written within about a second, as one with those that differ from it by their time alone."""
        alike = replace(entry, at=0.0)
        first, count = self._gathered.get(alike, (entry.at, 0))
        if count or len(self._gathered) < MOST_GATHERED:
            self._gathered[alike] = (first, count + entry.count)
        else:
            _tell([entry], "too many entries")
        self._begin()

    async def close(self) -> None:
        """Write what is gathered."""
        self._is_awaited.set()
        while self._writer is not None and not self._writer.done():
            await asyncio.wait([self._writer])

    def _begin(self) -> None:
        if self._writer is None or self._writer.done():
            self._writer = asyncio.create_task(self._write())

    async def _write(self) -> None:
        while self._awaited or self._gathered:
            if not self._awaited:
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._is_awaited.wait(), GATHER_S)
            self._is_awaited.clear()
            awaited, gathered = self._awaited, self._gathered
            self._awaited, self._gathered = [], {}
            entries = [replace(entry, at=first, count=count) for entry, (first, count) in gathered.items()]
            entries += [entry for entry, _ in awaited]
            try:
                await asyncio.to_thread(self._commit, entries)
            except DatabaseError as error:
                _tell(entries, str(error))
            finally:
                for _, written in awaited:
                    if not written.done():
                        written.set_result(None)

    def _commit(self, entries: list[Noted]) -> None:
        with self._database.write() as session:
            append(session, entries)


def _tell(entries: list[Noted], why: str) -> None:
    for entry in entries:
        log.error("not in the audit log", why=why, actor=entry.actor, action=entry.action, object=entry.object, status=entry.status)
