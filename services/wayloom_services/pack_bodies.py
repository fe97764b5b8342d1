"""Bodies of requests that continue a pack: stored file by file, and told to the database in batches."""

from collections.abc import Awaitable, Callable

from wayloom.errors import OffsetConflictError
from wayloom.store import uploads
from wayloom.store.arrivals import Checks, Whole
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.receiving.places import Arriving
from wayloom.store.tables.drives import Upload
from wayloom_services import upload_faults
from wayloom_services.context import Service
from wayloom_services.errors import ProtocolError

Pour = Callable[[Arriving], Awaitable[bool]]


async def receive_pack(service: Service, upload: Upload, start: int, checks: Checks, pour: Pour) -> int:
    """Store a request's bytes from `start` on, which `pour` hands on. Returns the offset afterwards. Every whole file is in its
    place then. Raises OffsetConflictError where another process has stored more since `start` was compared."""
    if isinstance(checks, Whole):
        raise ProtocolError(400, "unknown-checksum", "a pack's chunk is verified by Upload-Pieces, not by Upload-Checksum")
    rows = await service.in_thread(lambda: _rows(service, upload))
    with upload_faults.told():
        arrival = await service.in_thread(lambda: service.uploads.pack_arrival(upload, checks, rows))
        try:
            if arrival.offset != start:
                raise OffsetConflictError(f"{arrival.offset} bytes are stored, the chunk starts at {start}: ask with HEAD")
            if await pour(arrival):
                await service.in_thread(arrival.end)
        finally:
            await service.in_thread(arrival.close)
            await service.notify(*rows.messages)
    return arrival.offset


async def complete_pack(service: Service, upload: Upload) -> None:
    """All bytes are there: put those files into their places that a server which died has left."""

    async def nothing(_arrival: Arriving) -> bool:
        return True

    current = await service.read(lambda session: uploads.find(session, upload.id))
    if not current.complete:
        await receive_pack(service, current, current.length, None, nothing)


def _rows(service: Service, upload: Upload) -> PackRows:
    return PackRows(service.database, service.uploads.pack(upload), upload.files_done or 0, service.settings.upload_expiry_s)
