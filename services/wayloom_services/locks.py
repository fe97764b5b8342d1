"""Upload locks: one writer for each upload; a newer request takes over from one whose connection is dead."""

import asyncio
from collections.abc import AsyncIterable, AsyncIterator
from contextlib import asynccontextmanager

from wayloom_services.errors import ProtocolError


class UploadLocks:
    """Locks by upload id, for one event loop."""

    def __init__(self) -> None:
        self._holders: dict[str, tuple[asyncio.Lock, list[asyncio.Event]]] = {}

    @asynccontextmanager
    async def hold(self, upload_id: str) -> AsyncIterator[asyncio.Event]:
        """Ask the holder to stop, wait for it, then hold the lock. Yields the event that is set when another request asks."""
        lock, asked = self._holders.setdefault(upload_id, (asyncio.Lock(), []))
        for event in asked:
            event.set()
        mine = asyncio.Event()
        asked.append(mine)
        try:
            async with lock:
                yield mine
        finally:
            asked.remove(mine)
            if not asked:
                self._holders.pop(upload_id, None)


async def until_asked(body: AsyncIterable[bytes], asked: asyncio.Event) -> AsyncIterator[bytes]:
    """The body's chunks until its end, or until another request asks for the upload: then ProtocolError 423."""
    chunks = body.__aiter__()
    stop = asyncio.ensure_future(asked.wait())
    try:
        while True:
            chunk = asyncio.ensure_future(anext(chunks, None))
            await asyncio.wait({chunk, stop}, return_when=asyncio.FIRST_COMPLETED)
            if not chunk.done():
                chunk.cancel()
                raise ProtocolError(423, "taken-over", "another request has taken this upload over")
            if (content := chunk.result()) is None:
                return
            yield content
    finally:
        stop.cancel()
