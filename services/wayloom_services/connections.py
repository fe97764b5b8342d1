"""Connections that are not let hang, a request whose head does not come in time is dropped; and that read into one buffer."""

import asyncio
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

READ: Final = 256 << 10
"""Bytes that are read at once."""


def patient_protocol(head_s: float) -> type[H11Protocol]:
    """uvicorn's HTTP protocol, which waits for ever for a request's head, with a limit of so many seconds.

    All connections read into one buffer, since the loop hands on what it has read before it reads again: fresh memory for each read
    costs more than the read.
    """
    buffer = memoryview(bytearray(READ))

    class PatientProtocol(H11Protocol, asyncio.BufferedProtocol):
        """One connection."""

        def __init__(self, *arguments: Any, **named: Any) -> None:
            super().__init__(*arguments, **named)
            self._head_timer: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._await_head()

        def get_buffer(self, sizehint: int) -> memoryview:
            return buffer

        def buffer_updated(self, nbytes: int) -> None:
            self.data_received(bytes(buffer[:nbytes]))

        def data_received(self, data: bytes) -> None:
            if self._head_timer is None and not self._is_serving():
                self._await_head()  # the first bytes of a further request
            super().data_received(data)
            if self._is_serving():
                self._stop_waiting()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop_waiting()
            super().connection_lost(exc)

        def _is_serving(self) -> bool:
            return self.cycle is not None and not self.cycle.response_complete

        def _await_head(self) -> None:
            self._head_timer = self.loop.call_later(head_s, self._give_up)

        def _stop_waiting(self) -> None:
            if self._head_timer is not None:
                self._head_timer.cancel()
                self._head_timer = None

        def _give_up(self) -> None:
            self._head_timer = None
            if not self._is_serving():
                self.transport.abort()

    return PatientProtocol
