"""Upload locks: one writer for each upload; a newer request takes over from one whose connection is dead."""

import asyncio
from collections.abc import AsyncIterable, AsyncIterator
from contextlib import asynccontextmanager
from typing import TypeVar

from wayloom_services.errors import ProtocolError

T = TypeVar("T")


class Hold:
    """The right to write to an upload, until another request asks for it."""

    def __init__(self) -> None:
        self._asked = False
        self._waiting: asyncio.Timeout | None = None

    def ask(self) -> None:
        """Another request wants the upload: what waits for bytes waits no longer."""
        self._asked = True
        if self._waiting is not None and self._waiting.when() is not None:
            self._waiting.reschedule(asyncio.get_running_loop().time())

    def is_asked(self) -> bool:
        """Whether another request wants the upload."""
        return self._asked

    async def chunks(self, body: AsyncIterable[T], patience_s: float) -> AsyncIterator[T]:
        """The body's chunks until its end. Raises ProtocolError: 423 where another request asks for the upload, 408 where no byte
        comes for so long."""
        source = body.__aiter__()
        while not self._asked:
            try:
                async with asyncio.timeout(patience_s) as self._waiting:
                    chunk = await anext(source, None)
            except TimeoutError:
                break
            finally:
                self._waiting = None
            if chunk is None:
                return
            yield chunk
        raise self._end(patience_s)

    def _end(self, patience_s: float) -> ProtocolError:
        if self._asked:
            return ProtocolError(423, "taken-over", "another request has taken this upload over")
        said = f"no byte came for {patience_s:g} s: ask with HEAD and continue"
        return ProtocolError(408, "too-slow", said, {"Connection": "close"})


class UploadLocks:
    """Locks by upload id, for one event loop."""

    def __init__(self) -> None:
        self._holders: dict[str, tuple[asyncio.Lock, list[Hold]]] = {}

    @asynccontextmanager
    async def hold(self, upload_id: str) -> AsyncIterator[Hold]:
        """Ask the holder to stop, wait for it, then hold the lock."""
        lock, holds = self._holders.setdefault(upload_id, (asyncio.Lock(), []))
        for hold in holds:
            hold.ask()
        mine = Hold()
        holds.append(mine)
        try:
            async with lock:
                yield mine
        finally:
            holds.remove(mine)
            if not holds:
                self._holders.pop(upload_id, None)
