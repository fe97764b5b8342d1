"""Bodies of requests that continue a pack: stored file by file, and told to the database in batches."""

from collections.abc import Awaitable, Callable

from wayloom.errors import OffsetConflictError
from wayloom.store import packs, uploads
from wayloom.store.arrivals import Pieces
from wayloom.store.jobs import JobMessage
from wayloom.store.pack_arrivals import PackArrival
from wayloom.store.packs import Pack
from wayloom.store.tables.drives import Upload
from wayloom_services import upload_faults
from wayloom_services.context import Service
from wayloom_services.errors import ProtocolError

Pour = Callable[[PackArrival], Awaitable[bool]]
Checks = Pieces | tuple[str, bytes] | None


def stored_bytes(service: Service, upload: Upload) -> int:
    """The offset of an upload of one file or of a pack. Blocking."""
    if upload.files_done is None or upload.complete:
        return uploads.stored_bytes(service.folders, upload)
    pack = packs.of(service.folders, upload)
    at = packs.stored(service.folders, pack, upload.files_done)
    return pack.starts[at.files] + at.bytes


async def receive_pack(service: Service, upload: Upload, start: int, checks: Checks, pour: Pour) -> int:
    """Store a request's bytes from `start` on, which `pour` hands on. Returns the offset afterwards. Every whole file is in its
    place then. Raises OffsetConflictError where another process has stored more since `start` was compared."""
    if isinstance(checks, tuple):
        raise ProtocolError(400, "unknown-checksum", "a pack's chunk is verified by Upload-Pieces, not by Upload-Checksum")
    messages: list[JobMessage] = []
    with upload_faults.told():
        arrival = await service.in_thread(lambda: _arrival(service, upload, checks, messages))
        try:
            if arrival.offset != start:
                raise OffsetConflictError(f"{arrival.offset} bytes are stored, the chunk starts at {start}: ask with HEAD")
            if await pour(arrival):
                await service.in_thread(arrival.end)
        finally:
            await service.in_thread(arrival.close)
            await service.notify(*messages)
    return arrival.offset


async def complete_pack(service: Service, upload: Upload) -> None:
    """All bytes are there: put those files into their places that a server which died has left."""

    async def nothing(_arrival: PackArrival) -> bool:
        return True

    current = await service.read(lambda session: uploads.find(session, upload.id))
    if not current.complete:
        await receive_pack(service, current, current.length, None, nothing)


def _arrival(service: Service, upload: Upload, pieces: Pieces | None, messages: list[JobMessage]) -> PackArrival:
    done = upload.files_done or 0
    pack = packs.of(service.folders, upload)
    arrival = PackArrival(service.folders, pack, pieces, _Commit(service, pack, done, messages))
    arrival.begin(done)
    return arrival


class _Commit:
    """Tells the database of the files of a pack that are in their places, and gathers messages to the workers."""

    def __init__(self, service: Service, pack: Pack, done: int, messages: list[JobMessage]) -> None:
        self._service, self._pack, self._done, self._messages = service, pack, done, messages

    def __call__(self, end: int) -> None:
        expiry_s = self._service.settings.upload_expiry_s
        with self._service.database.write() as session:
            message = packs.mark_done(session, self._pack, self._done, end, expiry_s)
        self._done = end
        if message is not None:
            self._messages.append(message)
