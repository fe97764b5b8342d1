"""`python -m wayloom_workers worker|sweep`: one process; settings from the environment and WAYLOOM_CONFIG."""

import argparse
import signal
import sys

from celery import signals

from wayloom.config.json_log import configure_log
from wayloom.config.stages import queues
from wayloom.errors import WayloomError
from wayloom.pipeline.settings import WayloomSettings, load_settings
from wayloom.pipeline.usable import check_usable
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.drive_files import DriveFiles
from wayloom.store.folders import Folders
from wayloom.store.queues import TASK_NAME
from wayloom.store.receiving.opening import objects_of
from wayloom_workers.broker import make_app, make_notifier
from wayloom_workers.faults import limit_memory
from wayloom_workers.heartbeat import stop_requested
from wayloom_workers.runner import run_job
from wayloom_workers.stage_hooks import WorkerContext, load_hooks
from wayloom_workers.sweeper import sweep_until_stopped


def main() -> int:
    """Run until told to stop."""
    parser = argparse.ArgumentParser(prog="python -m wayloom_workers")
    parser.add_argument("role", choices=("worker", "sweep"))
    parser.add_argument("--queues", default=",".join(queues()), help="queues to work on, comma-separated")
    arguments = parser.parse_args()
    configure_log()
    try:
        loaded = load_settings()
        context = make_context(loaded.settings)
        if arguments.role == "sweep":
            _sweep(context)
        else:
            check_usable(loaded)
            _work(context, arguments.queues)
    except WayloomError as error:
        sys.stderr.write(f"wayloom worker: {error}\n")
        return 2
    return 0


def make_context(settings: WayloomSettings) -> WorkerContext:
    """The database, blobs and folders that the settings name."""
    folders = Folders(settings.data_dir)
    database, uploads = Database(settings.database), settings.uploads
    files = DriveFiles(folders, database, objects_of(uploads), uploads.fetched_bytes)
    return WorkerContext(settings, database, BlobStore(folders.blobs, settings.blob_url), folders, files)


def _sweep(context: WorkerContext) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop_requested.set())
    sweep_until_stopped(context)


def _work(context: WorkerContext, queues: str) -> None:
    """A Celery worker of one process: the stages' own threads are all the concurrency it has, and killing it kills the stage."""
    limit_memory(context.settings.stage_memory_bytes)
    hooks = load_hooks(context.settings.stage_hooks)
    app = make_app(context.settings)
    notify = make_notifier(app, context.database)

    @app.task(name=TASK_NAME)
    def _task(job_id: int) -> None:
        run_job(context, hooks, notify, job_id)

    signals.worker_shutting_down.connect(lambda **_: stop_requested.set(), weak=False)
    app.worker_main(
        ["worker", "--pool", "solo", "-Q", queues, "--without-gossip", "--without-mingle", "--without-heartbeat", "-l", "WARNING"]
    )


if __name__ == "__main__":
    sys.exit(main())
