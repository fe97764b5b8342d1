"""Service context of the endpoints: settings, database, blob storage, broker, metrics, and the API key check."""

import secrets
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

import anyio
import anyio.to_thread
import structlog
from celery import Celery
from fastapi import Depends, Request
from kombu.exceptions import OperationalError
from starlette.datastructures import Headers

from wayloom.config.service import ServiceSettings
from wayloom.store import jobs
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.folders import Folders
from wayloom.store.jobs import JobMessage
from wayloom.store.queues import TASK_NAME, celery_settings
from wayloom_services.errors import ProtocolError
from wayloom_services.locks import UploadLocks
from wayloom_services.metrics import Metrics

log = structlog.get_logger()
T = TypeVar("T")
FILE_THREADS = 16


@dataclass(frozen=True, slots=True)
class Service:
    """Shared resources of the endpoints: settings, database, blobs, broker, metrics, locks, threads."""

    settings: ServiceSettings
    database: Database
    blobs: BlobStore
    folders: Folders
    broker: Celery
    metrics: Metrics
    locks: UploadLocks = field(default_factory=UploadLocks)
    threads: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(FILE_THREADS))
    _sending: threading.Lock = field(default_factory=threading.Lock)

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run blocking work in one of a fixed number of threads."""
        return await anyio.to_thread.run_sync(work, limiter=self.threads)

    async def read(self, query: Callable[[Session], T]) -> T:
        """Run a query in a read-only transaction."""
        return await self.in_thread(lambda: self._read(query))

    async def write(self, change: Callable[[Session], T]) -> T:
        """Run a change in a transaction that commits when it returns."""
        return await self.in_thread(lambda: self._write(change))

    async def wake(self, woken: Iterable[JobMessage]) -> None:
        """After the commit: tell the workers. A broker that is away is no error, the sweeper tells them later."""
        if pending := list(woken):
            await self.in_thread(lambda: self._send(pending))

    def _read(self, query: Callable[[Session], T]) -> T:
        with self.database.read() as session:
            return query(session)

    def _write(self, change: Callable[[Session], T]) -> T:
        with self.database.write() as session:
            return change(session)

    def _send(self, pending: list[JobMessage]) -> None:
        try:
            with self._sending:
                for wake in pending:
                    self.broker.send_task(TASK_NAME, args=[wake.job_id], queue=wake.queue)
        except OperationalError as error:
            log.warning("broker is away", error=str(error))
            return
        jobs.mark_sent(self.database, pending)


def make_service(settings: ServiceSettings) -> Service:
    """Open everything that the settings name."""
    folders = Folders(settings.data_dir)
    broker = Celery("wayloom", set_as_current=False)
    broker.conf.update(celery_settings(settings.broker))
    database = Database(settings.database)
    return Service(settings, database, BlobStore(folders.blobs, settings.blob_url), folders, broker, Metrics())


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
        raise ProtocolError(401, "unauthorized", "this server wants its API key as a Bearer token", {"WWW-Authenticate": "Bearer"})


ServiceDep = Annotated[Service, Depends(the_service)]
