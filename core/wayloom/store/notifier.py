"""Notification of workers: one message a queued job, sent after the commit that queued it."""

import threading
from collections.abc import Iterable
from typing import Any, Protocol

import structlog

from wayloom.store.database import Database
from wayloom.store.jobs import JobMessage, mark_sent
from wayloom.store.queues import TASK_NAME

log = structlog.get_logger()


class Broker(Protocol):
    """As much of a Celery application as is needed: core does not know Celery."""

    def send_task(self, name: str, args: list[Any], *, queue: str) -> Any:
        """Put a message into a queue."""
        ...


class JobNotifier:
    """Sends job messages. A broker that is away is no error: the sweeper sends them later. Safe to share between threads."""

    def __init__(self, database: Database, broker: Broker, broker_errors: type[Exception] | tuple[type[Exception], ...]) -> None:
        """broker_errors : what the broker raises where it cannot be reached"""
        self._database, self._broker, self._errors = database, broker, broker_errors
        self._lock = threading.Lock()

    def __call__(self, messages: Iterable[JobMessage]) -> None:
        """Send each message and remember that it was sent; the first that cannot be sent ends it."""
        sent = []
        with self._lock:
            for message in messages:
                try:
                    self._broker.send_task(TASK_NAME, [message.job_id], queue=message.queue)
                except self._errors as error:
                    log.warning("broker is away", error=str(error))
                    break
                sent.append(message)
        mark_sent(self._database, sent)
