"""Large request bodies, received from the socket by a thread, past the event loop and the HTTP parser.

A loop that reads, parses and hands on 256 KiB at a time copies each byte five times and wakes three threads for it; that costs more
than SHA-256 does. A thread is held only while bytes come: the loop waits for the next ones.
"""

import asyncio
import mmap
import select
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, Self

from fastapi import Request

BUFFER: Final = 1 << 20
"""Whole buffers are stored, and pieces are parts of them: no byte waits for the other half of its piece."""
LARGE_BUFFER: Final = 2 << 20
LARGE_BODY: Final = 16 << 20
"""A body of so much is taken by large buffers: handing one over costs the same, and a kill still costs little of the body."""
BUFFERS: Final = 3
"""So far receiving may be ahead of storing: with two, each waits for the other one's slowest moments."""
TURN: Final = 32 << 20
TURN_S: Final = 0.25
"""Bytes, and seconds, after which a thread is given to the next request that waits for one."""
IDLE_MS: Final = 20
"""Nothing comes for so long: the thread is given back."""
LEAST: Final = 256 << 10
"""Bytes still to come of a body for which it is worth while."""
LENT: Final = "wayloom.lent_socket"
"""The ASGI extension by which the server lends a request's socket."""


class LentSocket:
    """What the server lends: asked for once, before anything of the body has been received. This one never lends."""

    def lend(self, least: int) -> tuple[socket.socket, bytes, int] | None:
        """The socket (to be closed), what has come of the body, and how many bytes are to come; None where the body has to be
        received as usual, as fewer than `least` bytes are to come, or it has no announced length."""

    def take_back(self, left: int) -> None:
        """The server goes on with the last `left` bytes of the body."""


class DirectBody:
    """Buffers that are filled from the socket, and stored: each by the thread that has filled it, or by another one meanwhile.

    left    bytes of the body that are not received yet
    broken  the connection has ended before the body has
    """

    def __init__(
        self, lent: LentSocket, link: socket.socket, early: bytes, left: int, store: Callable[[memoryview], None], *, ahead: bool
    ) -> None:
        self.left, self.broken = left, False
        self._lent, self._link, self._store = lent, link, store
        self._size = LARGE_BUFFER if left >= LARGE_BODY else BUFFER
        count = BUFFERS if ahead else 1
        pages = (memoryview(mmap.mmap(-1, self._size)) for _ in range(count))  # as direct writing wants them
        self._filling, *others = pages
        self._free = deque(others)
        self._filling[: len(early)] = early
        self._filled = len(early)
        self._thread = ThreadPoolExecutor(1) if ahead else None
        self._storing: deque[tuple[Future[None], memoryview]] = deque()
        self._failed = False
        self._poll = select.poll()
        self._poll.register(link, select.POLLIN)

    @classmethod
    def of(cls, request: Request, store: Callable[[memoryview], None], *, ahead: bool) -> Self | None:
        """That of a request, None where it has to be received as usual.

        store : takes the next bytes; called from a thread, one call after the other
        ahead : receive the next ones meanwhile, where storing waits for the disk; otherwise it only costs what handing over costs
        """
        lent: LentSocket = request.scope.get("extensions", {}).get(LENT) or LentSocket()
        found = lent.lend(LEAST)
        return None if found is None else cls(lent, *found, store, ahead=ahead)

    async def readable(self) -> AsyncIterator[bool]:
        """An item whenever there is something to receive, until the end."""
        loop = asyncio.get_running_loop()
        while self.left and not self.broken:
            ready = loop.create_future()
            loop.add_reader(self._link, _tell, ready)
            try:
                await ready
            finally:
                loop.remove_reader(self._link)
            yield True

    def receive(self, is_asked: Callable[[], bool]) -> None:
        """Receive and store what comes until nothing does for a moment. Where somebody else has asked for the upload, what has come
        is taken, and nothing is waited for. Blocking. Raises what storing raises."""
        last, until = max(0, self.left - TURN), time.monotonic() + TURN_S
        while self.left > last and not self.broken and time.monotonic() < until:
            room = min(self._size - self._filled, self.left)
            try:
                come = self._link.recv_into(self._filling[self._filled :], room)
            except BlockingIOError:
                if self._poll.poll(0 if is_asked() else IDLE_MS):
                    continue
                return
            except OSError:
                come = 0
            self.broken = come == 0
            self.left, self._filled = self.left - come, self._filled + come
            if self._filled == self._size:
                self._hand_over()

    def flush(self) -> None:
        """Store what has come. Blocking. Raises what storing raises."""
        if self._filled:
            self._hand_over()
        while self._storing:
            self._wait_for_first()

    def give_back(self) -> None:
        """Nothing is stored any more, the server has its socket again. From the event loop; `settle` first."""
        self._link.close()
        self._lent.take_back(self.left)

    def settle(self) -> None:
        """Wait for what is being stored. Blocking."""
        if self._thread is not None:
            self._thread.shutdown()

    def _hand_over(self) -> None:
        if self._thread is None:
            content, self._filled = self._filling[: self._filled], 0
            self._store_in_turn(content)
            return
        self._storing.append((self._thread.submit(self._store_in_turn, self._filling[: self._filled]), self._filling))
        self._filled = 0
        if not self._free:
            self._wait_for_first()
        self._filling = self._free.popleft()

    def _store_in_turn(self, content: memoryview) -> None:
        """Nothing behind bytes that could not be stored."""
        if self._failed:
            return
        self._failed = True
        self._store(content)
        self._failed = False

    def _wait_for_first(self) -> None:
        storing, buffer = self._storing.popleft()
        self._free.append(buffer)
        storing.result()


def _tell(ready: "asyncio.Future[None]") -> None:
    if not ready.done():
        ready.set_result(None)
