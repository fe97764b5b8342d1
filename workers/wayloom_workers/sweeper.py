"""Sweeper: every few seconds it looks for lost jobs, unsent messages and expired uploads. Two at once do no harm."""

import json
import time
from typing import Any, Final

import structlog
from celery import Celery
from kombu.exceptions import OperationalError
from redis.exceptions import RedisError

from wayloom.config.backoff import Backoff
from wayloom.errors import ConfigError, WayloomError
from wayloom.exclusion.areas import areas_of_geojson
from wayloom.pipeline.settings import WayloomSettings
from wayloom.store import excluded, garbage, jobs, retention, sweep, uploads
from wayloom.store.blobs import BlobError
from wayloom.store.database import DatabaseError
from wayloom_workers.broker import make_app, make_notifier, waiting_messages
from wayloom_workers.exclusion import exclude
from wayloom_workers.faults import crash_of
from wayloom_workers.heartbeat import stop_requested
from wayloom_workers.publishing import listed_tiles
from wayloom_workers.stage_hooks import WorkerContext

ORPHANS_EVERY_S: Final = 3600.0
"""Between two looks through all objects of the store that uploads go to."""
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
    context.files.drop_given_up()
    if (count := context.files.evict()) > 0:
        log.info("fetched logs dropped", drives=count)
    if (count := retention.delete_due(context.database, context.folders, settings.uploads, context.files)) > 0:
        log.info("images deleted", drives=count)
    forgotten = garbage.drop_forgotten(context.database, context.blobs, lambda: listed_tiles(context.folders))
    if forgotten:
        log.info("blobs of removed drives dropped", count=forgotten)
    exclude_late(context)
    context.database.settle()


def exclude_late(context: WorkerContext) -> None:
    """Drop what lies in excluded areas of drives that no stitch has looked at: held, or placed by the last version."""
    map_id = context.settings.map_id
    with context.database.read() as session:
        if not excluded.of_map(session, map_id) or jobs.is_map_at_work(session, map_id):
            return
    try:
        found = exclude(context, map_id)
    except WayloomError as error:  # the next stitch meets it too, and says so
        log.warning("areas were not excluded", error=str(error))
        return
    if found:
        with context.database.write() as session:
            jobs.request_stitch(session, map_id)  # sent as one that has not gone out


def areas_of(settings: WayloomSettings) -> list[tuple[str, dict[str, Any]]]:
    """Name and geometry of the excluded areas that the settings' file has. Raises InputError."""
    file = settings.excluded_areas
    try:
        return [] if file is None else areas_of_geojson(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise ConfigError(f"excluded_areas: cannot be read ({error})", file=file, remedy="name a GeoJSON file") from error


def exclude_by_settings(context: WorkerContext, found: list[tuple[str, dict[str, Any]]]) -> None:
    """Make the excluded areas of the settings these."""
    with context.database.write() as session:
        excluded.sync(session, context.settings.map_id, found)


def sweep_until_stopped(context: WorkerContext) -> None:
    """Sweep until this process is told to stop, whatever is away meanwhile. Raises InputError where the settings' file of areas
    cannot be read."""
    areas: list[tuple[str, dict[str, Any]]] | None = areas_of(context.settings)
    app, orphans_at = make_app(context.settings), time.monotonic()
    while not stop_requested.is_set():
        try:
            if time.monotonic() >= orphans_at:
                orphans_at = time.monotonic() + ORPHANS_EVERY_S
                context.files.drop_orphans()
            if areas is not None:
                exclude_by_settings(context, areas)
                areas = None
            sweep_once(context, app)
        except (BlobError, DatabaseError, OperationalError, RedisError, OSError) as error:
            log.warning("sweep failed", error=str(error))
        stop_requested.wait(context.settings.sweep_s)
