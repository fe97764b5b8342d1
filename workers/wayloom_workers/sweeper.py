"""The sweeper: every few seconds it looks for lost jobs, unsent messages and expired uploads. Two at once do no harm."""

import structlog
from kombu.exceptions import OperationalError
from redis.exceptions import RedisError

from wayloom.store import sweep, uploads
from wayloom.store.database import DatabaseError
from wayloom_workers.broker import JobNotifier, make_app
from wayloom_workers.heartbeat import stop_requested
from wayloom_workers.steps import WorkerContext

log = structlog.get_logger()


def sweep_once(bench: WorkerContext, waker: JobNotifier) -> None:
    """One look."""
    lost = sweep.requeue_lost(bench.database, bench.settings.max_attempts)
    if lost:
        log.warning("jobs lost their worker", count=lost)
    unsent = sweep.unsent(bench.database, bench.settings.resend_s)
    if unsent:
        lying = waker.waiting()  # a queue with messages has busy workers, not lost messages
        waker([wake for wake in unsent if lying[wake.queue] == 0])
    with bench.database.write() as session:
        uploads.drop_expired(session, bench.folders)


def sweep_until_stopped(bench: WorkerContext) -> None:
    """Sweep until this process is told to stop, whatever is away meanwhile."""
    waker = JobNotifier(make_app(bench.settings), bench.database)
    while not stop_requested.is_set():
        try:
            sweep_once(bench, waker)
        except (DatabaseError, OperationalError, RedisError, OSError) as error:
            log.warning("sweep failed", error=str(error))
        stop_requested.wait(bench.settings.sweep_s)
