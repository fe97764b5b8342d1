"""HTTP connections that are not let hang, read into one buffer, and lend their socket to whoever receives a large body.

A request whose head does not come in time is dropped.
"""

import asyncio
import socket
from typing import Any, Final, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from wayloom_services.direct_bodies import LENT, LentSocket

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
            before = self.scope
            super().data_received(data)
            if self._is_serving():
                self._stop_waiting()
                if self.scope is not before:  # the application has not run yet
                    cast(dict[str, Any], self.scope)["extensions"] = {LENT: _Lent(self)}

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


class _Lent(LentSocket):
    """The socket of one request. Meanwhile its connection reads nothing, and the parser is told afterwards what it has missed."""

    def __init__(self, protocol: H11Protocol) -> None:
        self._protocol, self._cycle = protocol, protocol.cycle
        self._reader = cast(Any, protocol.conn)._reader  # h11 has no way to say "so many bytes of this body have come"

    def lend(self, least: int) -> tuple[socket.socket, bytes, int] | None:
        left = getattr(self._reader, "_remaining", 0)  # of a body with Content-Length alone
        if left < least or not self._is_receiving() or self._cycle.waiting_for_100_continue:
            return None
        shared = self._protocol.transport.get_extra_info("socket")
        if shared is None or self._protocol.transport.get_extra_info("sslcontext") is not None:
            return None
        self._protocol.flow.pause_reading()
        early, self._cycle.body = bytes(self._cycle.body), bytearray()
        return shared.dup(), early, left

    def take_back(self, left: int) -> None:
        if not self._is_receiving():
            return
        self._reader._remaining = left
        if left == 0:
            self._protocol.handle_events()
        self._protocol.flow.resume_reading()

    def _is_receiving(self) -> bool:
        return (
            self._protocol.cycle is self._cycle
            and self._protocol.conn.their_state is h11.SEND_BODY
            and not self._cycle.disconnected
            and not self._protocol.transport.is_closing()
        )
