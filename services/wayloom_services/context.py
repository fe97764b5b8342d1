"""Service context of the endpoints: settings, database, blob storage, broker, metrics, and the API key check."""

import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

import anyio
import anyio.to_thread
from celery import Celery
from fastapi import Depends, Request
from kombu.exceptions import OperationalError
from starlette.datastructures import Headers

from wayloom.config.service import ServiceSettings
from wayloom.store.arrivals import RunningDigests
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.folders import Folders
from wayloom.store.jobs import JobMessage
from wayloom.store.notifier import JobNotifier
from wayloom.store.queues import celery_settings
from wayloom.store.tile_reads import HeldBlobs, TileReads
from wayloom_services.errors import no_key
from wayloom_services.locks import UploadLocks
from wayloom_services.metrics import Metrics

T = TypeVar("T")
FILE_THREADS = 16


@dataclass(frozen=True, slots=True)
class Service:
    """Shared resources of the endpoints: settings, database, blobs, notifier of the workers, metrics, look-ups of tiles, blobs held
    in memory; of uploads the running digests, locks, threads."""

    settings: ServiceSettings
    database: Database
    blobs: BlobStore
    folders: Folders
    notifier: JobNotifier
    metrics: Metrics
    tiles: TileReads
    held: HeldBlobs
    digests: RunningDigests = field(default_factory=RunningDigests)
    locks: UploadLocks = field(default_factory=UploadLocks)
    threads: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(FILE_THREADS))

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run blocking work in one of a fixed number of threads."""
        return await anyio.to_thread.run_sync(work, limiter=self.threads)

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
    return Service(settings, database, blobs, folders, notifier, Metrics(), TileReads(database), held)


def the_service(request: Request) -> Service:
    """The service context of a request's application."""
    service: Service = request.app.state.service
    return service


def has_key(headers: Headers, key: str | None) -> bool:
    """Whether the request's headers hold the API key; True where none is set."""
    scheme, _, given = headers.get("authorization", "").partition(" ")
    return key is None or (scheme.lower() == "bearer" and secrets.compare_digest(given.strip().encode(), key.encode()))


async def require_key(request: Request) -> None:
    """Dependency that refuses a request without the API key, where one is set."""
    if not has_key(request.headers, the_service(request).settings.api_key):
        raise no_key()


ServiceDep = Annotated[Service, Depends(the_service)]
