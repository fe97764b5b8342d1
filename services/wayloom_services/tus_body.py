"""Upload bodies: receiving, storing, verifying, and moving a whole file into its drive."""

import asyncio
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Final, Protocol, Self

from fastapi import Request
from starlette.requests import ClientDisconnect

from wayloom.store import drives, uploads
from wayloom.store.arrivals import Checks, Whole
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.tables.drives import Upload
from wayloom_services import upload_faults
from wayloom_services.context import Service
from wayloom_services.direct_bodies import DirectBody
from wayloom_services.errors import ProtocolError
from wayloom_services.locks import Hold
from wayloom_services.pack_bodies import complete_pack, receive_pack
from wayloom_services.tus_headers import CHECKSUMS, checksum, pieces

BUFFER: Final = 1 << 20
PROLONG_S: Final = 60.0
"""How often the expiry of an upload is put off while its bytes come; a quarter of the expiry where that is less."""


class Sink(Protocol):
    """Where a body's bytes go.

    waits_for_disk : taking them does; otherwise they go to memory, and to the disk behind it
    """

    waits_for_disk: bool

    def take(self, content: memoryview) -> None:
        """The next bytes. Blocking."""


def checks_of(request: Request) -> Checks:
    """What the request says of its body's bytes, to verify them by."""
    whole, parts = checksum(request), pieces(request)
    if whole is not None and parts is not None:
        raise ProtocolError(400, "bad-header", "Upload-Checksum and Upload-Pieces exclude each other")
    return parts if whole is None else Whole(CHECKSUMS[whole[0]](), whole[1])


async def receive(request: Request, service: Service, upload: Upload, start: int, checks: Checks, hold: Hold) -> int:
    """Store the request's body from `start` on. Returns the offset afterwards."""
    room = upload.length - start
    announced = request.headers.get("content-length", "")
    if announced.isdigit() and int(announced) > room:
        raise ProtocolError(413, "too-large", f"the chunk has {announced} bytes, the file only {room} more")
    if upload.files_done is not None:
        return await receive_pack(
            service, upload, start, checks, lambda arrival: _pour(request, service, upload, arrival, room, hold)
        )
    with upload_faults.told():
        arrival = await service.in_thread(lambda: service.uploads.arrival(upload, start, checks))
        try:
            if await _pour(request, service, upload, arrival, room, hold):
                await service.in_thread(arrival.end)
        finally:
            await service.in_thread(arrival.close)
    return arrival.offset


async def _pour(request: Request, service: Service, upload: Upload, arrival: Sink, room: int, hold: Hold) -> bool:
    """Hand on the body, at most `room` bytes, a buffer at a time: while one is stored the next one comes. What has come before a
    broken link is handed on too. Returns whether the body came to its end."""
    expiry = _Expiry(service, upload.id)

    def store(content: memoryview) -> None:
        service.metrics.upload_bytes.inc(len(content))
        arrival.take(content)

    body = DirectBody.of(request, store, ahead=arrival.waits_for_disk)
    if body is not None:
        return await _pour_directly(body, service, expiry, hold)
    come = 0
    async with _Pipe(service, store) as pipe:
        try:
            async for chunk in hold.chunks(request.stream(), service.settings.body_pause_s):
                come += len(chunk)
                if come > room:
                    pipe.drop()
                    raise ProtocolError(413, "too-large", f"the chunk has more than the {room} bytes that the file lacks")
                await pipe.put(chunk)
                await expiry.put_off()
        except ClientDisconnect:
            return False
    return True


async def _pour_directly(body: DirectBody, service: Service, expiry: "_Expiry", hold: Hold) -> bool:
    """As `_pour`, of a body that is received by threads: no longer than its announced length."""
    try:
        try:
            async for _ in hold.chunks(body.readable(), service.settings.body_pause_s):
                await _until_done(service.for_body(lambda: body.receive(hold.is_asked)))
                await expiry.put_off()
        except ProtocolError:
            await _until_done(service.for_body(lambda: body.receive(hold.is_asked)))
            await _until_done(service.for_body(body.flush))
            raise
        await _until_done(service.for_body(body.flush))
    finally:
        try:
            await _until_done(service.for_body(body.settle))
        finally:
            body.give_back()
    return not body.broken


class _Expiry:
    """Of an upload, put off while its bytes come."""

    def __init__(self, service: Service, upload_id: str) -> None:
        self._service, self._id, self._expiry_s = service, upload_id, service.settings.upload_expiry_s
        self._clock = asyncio.get_running_loop().time
        self._at = self._clock()

    async def put_off(self) -> None:
        """Where the last time is long enough ago."""
        if self._clock() - self._at > min(PROLONG_S, self._expiry_s / 4):
            await self._service.write(lambda session: uploads.prolong(session, self._id, self._expiry_s))
            self._at = self._clock()


async def _until_done(work: Awaitable[None]) -> None:
    """Wait for a thread, also when the request is cancelled: what it writes to is closed next. Raises what it has raised."""
    future = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.wait([future])
        except asyncio.CancelledError as error:
            cancelled = error
    failure = cancelled or future.exception()
    if failure is not None:
        raise failure


class _Pipe:
    """A buffer that fills while the one before is stored by a thread. At the end of the block everything is stored.

    Whole buffers are handed on, and pieces are parts of them: no byte waits for the other half of its piece.
    """

    def __init__(self, service: Service, store: Callable[[memoryview], None]) -> None:
        self._service, self._store = service, store
        self._filling, self._other = memoryview(bytearray(BUFFER)), memoryview(bytearray(BUFFER))
        self._filled = 0
        self._storing: asyncio.Future[None] | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is None or issubclass(kind, ProtocolError):
                await self._flush()
        finally:
            await self._stored()

    async def put(self, chunk: bytes) -> None:
        """The next bytes of the body. Raises what storing those before has raised."""
        left = memoryview(chunk)
        while left:
            some = left[: BUFFER - self._filled]
            self._filling[self._filled : self._filled + len(some)] = some
            self._filled += len(some)
            left = left[len(some) :]
            if self._filled == BUFFER:
                await self._flush()

    def drop(self) -> None:
        """Forget what is not being stored yet."""
        self._filled = 0

    async def _flush(self) -> None:
        await self._stored()
        content = self._filling[: self._filled]
        self._filling, self._other, self._filled = self._other, self._filling, 0
        self._storing = asyncio.ensure_future(self._service.in_thread(lambda: self._store(content)))

    async def _stored(self) -> None:
        """Wait for the thread that stores. Raises what storing has raised."""
        if self._storing is not None:
            storing, self._storing = self._storing, None
            await _until_done(storing)


async def complete(service: Service, upload: Upload) -> None:
    """The file is whole: verify it, move it into its drive, and start the drive's jobs when it was the last one.

    To be called again after whatever ended it: what is done is found done.
    """
    if upload.files_done is not None:
        await complete_pack(service, upload)
        return
    file = await service.read(lambda session: uploads.promised(session, upload))
    if not file.complete:
        found = await service.in_thread(lambda: service.uploads.settle(upload, file.sha256))
        if found != file.sha256:
            await forget(service, upload)
            raise ProtocolError(
                460, "file-mismatch", f"{upload.path} has SHA-256 {found}, its manifest says {file.sha256}: send it again"
            )

    def finish(session: Session) -> JobMessage | None:
        uploads.mark_complete(session, upload.id)
        return drives.mark_complete(session, upload.drive_id, upload.path, upload.id if service.uploads.in_objects else None)

    await service.notify(await service.write(finish))


async def forget(service: Service, upload: Upload) -> None:
    """Drop the upload and its bytes."""
    await service.write(lambda session: uploads.remove(session, upload.id))
    await service.in_thread(lambda: service.uploads.drop(upload))
