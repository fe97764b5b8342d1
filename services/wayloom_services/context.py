"""Service context of the endpoints: settings, database, blob storage, broker, metrics, access."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, TypeVar

import anyio
import anyio.to_thread
from celery import Celery
from fastapi import Depends, Request
from kombu.exceptions import OperationalError

from wayloom.config.service import ServiceSettings
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.folders import Folders
from wayloom.store.jobs import JobMessage
from wayloom.store.notifier import JobNotifier
from wayloom.store.queues import celery_settings
from wayloom.store.receiving.opening import open_place
from wayloom.store.receiving.places import UploadPlace
from wayloom.store.tile_reads import HeldBlobs, TileReads
from wayloom_services.access.buckets import TokenBuckets
from wayloom_services.access.callers import Callers, caller_of
from wayloom_services.access.needs import need_of
from wayloom_services.access.oidc.optional import provider_of
from wayloom_services.access.trail import Trail
from wayloom_services.errors import no_key
from wayloom_services.etas import Past
from wayloom_services.locks import UploadLocks
from wayloom_services.metrics import Metrics

if TYPE_CHECKING:
    from wayloom_services.access.oidc.provider import Provider

T = TypeVar("T")
FILE_THREADS = 16
BODY_THREADS = 16
"""Threads that receive large bodies, beside those that everything else needs: however many bodies come, a query waits for none."""
SIGN_INS = (0.2, 10)
"""Tries of one address: a second in the long run, and at once before that counts."""
HASHES_AT_ONCE = 2
"""Of passwords: each takes 64 MiB and some tens of milliseconds of a core."""


@dataclass(frozen=True, slots=True)
class Service:
    """Shared resources of the endpoints: settings, database, blobs, place of the uploads, notifier of the workers, metrics,
    look-ups of tiles, blobs held in memory; of access the callers, the audit log's trail, rates of known callers, of strangers and
    of sign-ins by address, the OpenID provider where there is one; what earlier drives took; of uploads the locks, and threads for
    bodies; threads for all else."""

    settings: ServiceSettings
    database: Database
    blobs: BlobStore
    folders: Folders
    uploads: UploadPlace
    notifier: JobNotifier
    metrics: Metrics
    tiles: TileReads
    held: HeldBlobs
    callers: Callers
    trail: Trail
    rates: TokenBuckets
    strangers: TokenBuckets
    oidc: "Provider | None" = None
    sign_ins: TokenBuckets = field(default_factory=lambda: TokenBuckets(*SIGN_INS))
    hashing: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(HASHES_AT_ONCE))
    past: Past = field(default_factory=Past)
    locks: UploadLocks = field(default_factory=UploadLocks)
    bodies: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(BODY_THREADS))
    threads: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(FILE_THREADS))

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run blocking work in one of a fixed number of threads."""
        return await anyio.to_thread.run_sync(work, limiter=self.threads)

    async def for_body(self, work: Callable[[], T]) -> T:
        """Receive or store a large body's bytes in one of the threads that do nothing else."""
        return await anyio.to_thread.run_sync(work, limiter=self.bodies)

    async def read(self, query: Callable[[Session], T]) -> T:
        """Run a query in a read-only transaction."""
        return await self.in_thread(lambda: self._read(query))

    async def write(self, change: Callable[[Session], T]) -> T:
        """Run a change in a transaction that commits when it returns."""
        return await self.in_thread(lambda: self._write(change))

    async def notify(self, *messages: JobMessage | None) -> None:
        """After the commit: tell the workers of the jobs that it queued, if any."""
        if pending := [message for message in messages if message is not None]:
            await self.in_thread(lambda: self.notifier(pending))

    def _read(self, query: Callable[[Session], T]) -> T:
        with self.database.read() as session:
            return query(session)

    def _write(self, change: Callable[[Session], T]) -> T:
        with self.database.write() as session:
            return change(session)


def make_service(settings: ServiceSettings) -> Service:
    """Open everything that the settings name."""
    folders = Folders(settings.data_dir)
    broker = Celery("wayloom", set_as_current=False)
    broker.conf.update(celery_settings(settings.broker))
    database = Database(settings.database)
    notifier = JobNotifier(database, broker, OperationalError)
    blobs = BlobStore(folders.blobs, settings.blob_url)
    held = HeldBlobs(blobs, settings.held_blobs_bytes)
    access = settings.access
    uploads, rates = open_place(settings.uploads, folders, database), (access.requests_a_second, access.requests_at_once)
    return Service(
        settings, database, blobs, folders, uploads, notifier, Metrics(), TileReads(database), held, Callers(database, settings),
        Trail(database), rates=TokenBuckets(*rates), strangers=TokenBuckets(access.strangers_a_second, access.strangers_at_once),
        oidc=provider_of(access),
    )  # fmt: skip


def the_service(request: Request) -> Service:
    """The service context of a request's application."""
    service: Service = request.app.state.service
    return service


async def require_key(request: Request) -> None:
    """Dependency that refuses a request which no guard has let through: by the route that was chosen, and the caller."""
    need = need_of(request.scope["route"].path, request.method)
    caller = caller_of(request.scope)
    if need is None or not caller.may(need):
        raise no_key()


ServiceDep = Annotated[Service, Depends(the_service)]
