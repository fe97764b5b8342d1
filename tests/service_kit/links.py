"""A bad link: a TCP relay before a server that breaks connections after so many bytes, or flips one."""

import contextlib
import socket
import struct
import threading
from collections.abc import Callable
from urllib.parse import urlsplit

BLOCK = 16 << 10


class BadLink:
    """Relays to `url`.

    break_after  every connection is cut after so many bytes from the client
    resets       it is cut by a reset, as by a router that has forgotten it, not by an end
    at, then     what is called when so many bytes from the client have gone on to the server
    flip_at      the byte that is flipped, counted over all bytes from the client
    sent         bytes that the client has sent in all
    """

    def __init__(
        self,
        url: str,
        break_after: int | None = None,
        flip_at: int | None = None,
        resets: bool = False,
        at: int | None = None,
        then: Callable[[], None] = int,
    ) -> None:
        self._to = (str(urlsplit(url).hostname), int(urlsplit(url).port or 80))
        self._break_after, self._flip_at, self._resets, self._at, self._then = break_after, flip_at, resets, at, then
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._lock = threading.Lock()
        self.sent, self.broken = 0, 0
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listener.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._relay, args=(client,), daemon=True).start()

    def _relay(self, client: socket.socket) -> None:
        """Both ways, until one end closes or the link breaks; what the client has sent by then and nobody has read is lost."""
        with client, socket.create_connection(self._to) as server:
            back = threading.Thread(target=self._down, args=(client, server), daemon=True)
            back.start()
            self._up(client, server)
            back.join()

    def _up(self, client: socket.socket, server: socket.socket) -> None:
        left = self._break_after
        with contextlib.suppress(OSError):
            while content := client.recv(BLOCK if left is None else min(BLOCK, left)):
                self._hand_on(content, server)
                if left is not None and (left := left - len(content)) == 0:
                    self.broken += 1
                    break
        (_reset if self._resets and left == 0 else _shut)(client, server)

    def _hand_on(self, content: bytes, server: socket.socket) -> None:
        before = self.sent
        counted = self._count(content)
        if self._at is None or not before < self._at <= before + len(content):
            server.sendall(counted)
            return
        server.sendall(counted[: self._at - before])
        self.broken += 1
        self._then()

    def _count(self, content: bytes) -> bytes:
        with self._lock:
            at, self.sent = self.sent, self.sent + len(content)
        if self._flip_at is not None and at <= self._flip_at < at + len(content):
            i = self._flip_at - at
            return content[:i] + bytes([content[i] ^ 1]) + content[i + 1 :]
        return content

    def _down(self, client: socket.socket, server: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while content := server.recv(BLOCK):
                client.sendall(content)
        _shut(client, server)


def _shut(*ends: socket.socket) -> None:
    for end in ends:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def _reset(*ends: socket.socket) -> None:
    for end in ends:
        with contextlib.suppress(OSError):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            end.shutdown(socket.SHUT_RD)  # wakes whoever reads, and tells the other end nothing


class Gate:
    """Relays to `url` while it is open; shut, it ends every connection, as of a server that is away."""

    def __init__(self, url: str) -> None:
        self._to = (str(urlsplit(url).hostname), int(urlsplit(url).port or 80))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._is_open, self._links = True, set[socket.socket]()
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def shut(self) -> None:
        """End the connections that there are, and each new one."""
        self._is_open = False
        for link in list(self._links):
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)

    def open(self) -> None:
        """Relay again."""
        self._is_open = True

    def close(self) -> None:
        """Take no more connections."""
        self._listener.close()
        self.shut()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                if self._is_open:
                    server = socket.create_connection(self._to)
                    self._links |= {client, server}
                    for ends in ((client, server), (server, client)):
                        threading.Thread(target=self._relay, args=ends, daemon=True).start()
                else:
                    client.close()

    def _relay(self, source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while content := source.recv(1 << 16):
                target.sendall(content)
        for link in (source, target):
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
