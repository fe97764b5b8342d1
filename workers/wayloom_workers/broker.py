"""Celery application of the workers. A message is nothing but a job's id; losing one costs seconds."""

from celery import Celery
from kombu.exceptions import OperationalError

from wayloom.config.service import ServiceSettings
from wayloom.config.stages import queues
from wayloom.store.database import Database
from wayloom.store.notifier import JobNotifier
from wayloom.store.queues import celery_settings


def make_app(settings: ServiceSettings) -> Celery:
    """A Celery application on the settings' broker."""
    app = Celery("wayloom", set_as_current=False)
    app.conf.update(celery_settings(settings.broker))
    return app


def make_notifier(app: Celery, database: Database) -> JobNotifier:
    """What sends job messages through the application's broker."""
    return JobNotifier(database, app, OperationalError)


def waiting_messages(app: Celery) -> dict[str, int]:
    """How many messages lie in each queue. Raises OperationalError when the broker is away."""
    with app.connection_for_read() as connection:
        channel = connection.default_channel
        return {queue: int(channel._size(queue)) for queue in queues()}
