"""The Celery application. A message is nothing but a job's id; losing one costs seconds."""

import threading
from collections.abc import Iterable

import structlog
from celery import Celery
from kombu.exceptions import OperationalError

from wayloom.config.service import ServiceSettings
from wayloom.store import jobs
from wayloom.store.database import Database
from wayloom.store.jobs import JobMessage
from wayloom.store.queues import QUEUES, TASK_NAME, celery_settings

log = structlog.get_logger()


def make_app(settings: ServiceSettings) -> Celery:
    """A Celery application on the settings' broker."""
    app = Celery("wayloom", set_as_current=False)
    app.conf.update(celery_settings(settings.broker))
    return app


class JobNotifier:
    """Tells workers of jobs. A broker that is away is no error: the sweeper tells them later."""

    def __init__(self, app: Celery, database: Database) -> None:
        self._app, self._database = app, database
        self._lock = threading.Lock()

    def __call__(self, woken: Iterable[JobMessage]) -> None:
        """Send a message for each job and remember that it was sent."""
        sent = []
        with self._lock:
            for wake in woken:
                try:
                    self._app.send_task(TASK_NAME, args=[wake.job_id], queue=wake.queue)
                    sent.append(wake)
                except OperationalError as error:
                    log.warning("broker is away", error=str(error))
                    break
        jobs.mark_sent(self._database, sent)

    def waiting(self) -> dict[str, int]:
        """How many messages lie in each queue. Raises OperationalError when the broker is away."""
        with self._app.connection_for_read() as connection:
            channel = connection.default_channel
            return {queue: int(channel._size(queue)) for queue in QUEUES}
