"""Sweeper: every few seconds it looks for lost jobs, unsent messages and expired uploads. Two at once do no harm."""

import structlog
from celery import Celery
from kombu.exceptions import OperationalError
from redis.exceptions import RedisError

from wayloom.config.backoff import Backoff
from wayloom.store import garbage, retention, sweep, uploads
from wayloom.store.blobs import BlobError
from wayloom.store.database import DatabaseError
from wayloom_workers.broker import make_app, make_notifier, waiting_messages
from wayloom_workers.faults import crash_of
from wayloom_workers.heartbeat import stop_requested
from wayloom_workers.publishing import listed_tiles
from wayloom_workers.stage_hooks import WorkerContext

log = structlog.get_logger()


def sweep_once(context: WorkerContext, app: Celery) -> None:
    """One look."""
    settings = context.settings
    backoff = Backoff(settings.retry_first_s, settings.retry_longest_s)
    lost = sweep.requeue_lost(
        context.database, settings.max_attempts, settings.max_losses, backoff, lambda held: crash_of(context.folders, held)
    )
    if lost:
        log.warning("jobs lost their worker", count=lost)
    unsent = sweep.unsent(context.database, context.settings.resend_s)
    if unsent:
        waiting = waiting_messages(app)  # a queue with messages has busy workers, not lost messages
        make_notifier(app, context.database)(message for message in unsent if waiting[message.queue] == 0)
    with context.database.write() as session:
        uploads.drop_expired(session, context.folders)
    if (count := retention.delete_due(context.database, context.folders, settings.uploads)) > 0:
        log.info("images deleted", drives=count)
    forgotten = garbage.drop_forgotten(context.database, context.blobs, lambda: listed_tiles(context.folders))
    if forgotten:
        log.info("blobs of removed drives dropped", count=forgotten)
    context.database.settle()


def sweep_until_stopped(context: WorkerContext) -> None:
    """Sweep until this process is told to stop, whatever is away meanwhile."""
    app = make_app(context.settings)
    while not stop_requested.is_set():
        try:
            sweep_once(context, app)
        except (BlobError, DatabaseError, OperationalError, RedisError, OSError) as error:
            log.warning("sweep failed", error=str(error))
        stop_requested.wait(context.settings.sweep_s)
