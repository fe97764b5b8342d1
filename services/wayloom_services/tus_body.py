"""Upload bodies: receiving, storing, verifying, and moving a whole file into its drive."""

import hashlib
import os
from asyncio import Event
from typing import Final, Protocol

from fastapi import Request
from starlette.requests import ClientDisconnect

from wayloom.store import drives, uploads
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.tables import Upload
from wayloom.store.uploads import Part, write_at
from wayloom_services.context import Service
from wayloom_services.errors import ProtocolError
from wayloom_services.locks import until_asked
from wayloom_services.tus_headers import CHECKSUMS

BUFFER: Final = 1 << 20


class Digest(Protocol):
    """A running hash."""

    def update(self, content: bytes, /) -> None: ...
    def digest(self) -> bytes: ...


async def receive(
    request: Request, service: Service, upload: Upload, start: int, checksum: tuple[str, bytes] | None, asked: Event
) -> int:
    """Store the request's body from `start` on. Returns the offset afterwards."""
    room = upload.length - start
    announced = request.headers.get("content-length", "")
    if announced.isdigit() and int(announced) > room:
        raise ProtocolError(413, "too-large", f"the chunk has {announced} bytes, the file only {room} more")
    target = uploads.part(service.folders, upload.id)
    staged = uploads.staged_part(service.folders, upload.id)
    try:
        if checksum is None:
            await _store(request, service, target, start, room, None, asked)
            return await service.in_thread(target.size)
        digest = CHECKSUMS[checksum[0]]()
        await service.in_thread(staged.drop)
        await _store(request, service, staged, 0, room, digest, asked)
        if digest.digest() != checksum[1]:
            raise ProtocolError(460, "checksum-mismatch", "the chunk's bytes do not have the checksum that was sent: send it again")
        await service.in_thread(lambda: target.append(staged))
    except OSError as error:
        raise ProtocolError(507, "no-space", f"the bytes could not be stored: {error.strerror}") from error
    finally:
        if checksum is not None:
            await service.in_thread(staged.drop)
    return await service.in_thread(target.size)


async def _store(
    request: Request, service: Service, target: Part, start: int, room: int, digest: Digest | None, asked: Event
) -> None:
    """Write the body at `start`, at most `room` bytes, a buffer at a time. What has come before a broken link is written."""
    fd = await service.in_thread(target.open)
    position, buffer = start, bytearray()

    def flush(content: bytes, at: int) -> None:
        write_at(fd, content, at)
        if digest is not None:
            digest.update(content)

    try:
        try:
            async for chunk in until_asked(request.stream(), asked):
                if position + len(buffer) + len(chunk) > start + room:
                    raise ProtocolError(413, "too-large", f"the chunk has more than the {room} bytes that the file lacks")
                buffer += chunk
                if len(buffer) >= BUFFER:
                    content, at = bytes(buffer), position
                    await service.in_thread(lambda content=content, at=at: flush(content, at))  # type: ignore[misc]
                    position, buffer = position + len(content), bytearray()
        except ClientDisconnect:
            if digest is not None:
                raise ProtocolError(400, "disconnected", "the link broke before the chunk was whole") from None
        await service.in_thread(lambda: flush(bytes(buffer), position))
    finally:
        await service.in_thread(lambda: os.close(fd))
    service.metrics.upload_bytes.inc(position + len(buffer) - start)


async def complete(service: Service, upload: Upload) -> None:
    """The file is whole: verify it, move it into its drive, and start the drive's jobs when it was the last one."""
    stored = uploads.part(service.folders, upload.id)
    expected = await service.read(lambda session: uploads.expected_digest(session, upload))
    found = await service.in_thread(lambda: stored.digest() if upload.length else hashlib.sha256().hexdigest())
    if found != expected:
        await forget(service, upload)
        raise ProtocolError(
            460, "checksum-mismatch", f"{upload.path} has SHA-256 {found}, its manifest says {expected}: send it again"
        )
    await service.in_thread(lambda: stored.install(service.folders.drive(upload.drive_id) / upload.path))

    def finish(session: Session) -> JobMessage | None:
        uploads.mark_complete(session, upload.id)
        return drives.mark_complete(session, upload.drive_id, upload.path)

    await service.notify(await service.write(finish))


async def forget(service: Service, upload: Upload) -> None:
    """Drop the upload and its bytes."""
    await service.write(lambda session: uploads.remove(session, upload.id))
    await service.in_thread(uploads.part(service.folders, upload.id).drop)
