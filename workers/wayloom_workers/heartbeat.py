"""Heartbeat of a running job: a thread that prolongs its lease and reports its progress."""

import os
import threading
import time
from types import TracebackType
from typing import Final, Self

import structlog

from wayloom.errors import LeaseLostError, WayloomError
from wayloom.store.database import DatabaseError
from wayloom.store.jobs import Claim, fail, heartbeat
from wayloom.store.sweep import STOPPING
from wayloom_workers.stage_hooks import WorkerContext

TOO_LONG: Final = 75
"""Exit status of a worker whose stage took too long."""
STOP_LOOK_S: Final = 0.1
log = structlog.get_logger()
stop_requested = threading.Event()
"""Set when this process is told to stop; a running stage ends at its next sign of progress."""


class StopRequestedError(WayloomError):
    """The worker is told to stop: leave the job to the next one."""

    code = "stop-requested"


class Heartbeat:
    """A context in which the job's lease is prolonged. It is the stage's `Progress`: calling it after the lease is lost raises."""

    def __init__(self, context: WorkerContext, held: Claim) -> None:
        self._context, self._held = context, held
        self._share, self._what, self._stop_is_told = 0.0, "", False
        self._over, self._lost = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._beat, name=f"heartbeat-{held.job_id}", daemon=True)

    def __call__(self, share: float, what: str, /) -> None:
        """Tell the share done, 0 to 1. Raises LeaseLostError, StopRequestedError."""
        self._share, self._what = max(self._share, min(share, 1.0)), what
        self.check()
        if stop_requested.is_set():
            raise StopRequestedError("the worker is told to stop")

    def check(self) -> None:
        """Raise LeaseLostError when the job is another's."""
        if self._lost.is_set():
            raise LeaseLostError(
                f"job {self._held.job_id} ({self._held.stage}): another worker has taken it over, or its drive is gone"
            )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()

    def _pause(self, seconds: float) -> bool:
        """Wait for the next beat, and not so long where the worker has just been told to stop: it may have a second to live.
        Returns whether the job is over."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0 and (self._stop_is_told or not stop_requested.is_set()):
            if self._over.wait(min(left, STOP_LOOK_S)):
                return True
        return self._over.is_set()

    def _end_process(self, limit_s: float, max_attempts: int) -> None:
        """The stage takes too long. Compiled code cannot be interrupted, so the process ends, and another takes its place."""
        error = f"took longer than {limit_s:g} s, the limit of a stage, at {self._share:.0%} {self._what}".strip()
        try:
            with self._context.database.write() as session:
                fail(session, self._held, error, final=self._held.attempt >= max_attempts)
        except (LeaseLostError, DatabaseError) as lost:
            log.warning("the stage is ended without a word", error=str(lost))
        log.error("stage ended", error=error)
        os._exit(TOO_LONG)

    def _beat(self) -> None:
        settings = self._context.settings
        started = time.monotonic()
        good_until = started + settings.lease_s
        while not self._pause(settings.heartbeat_s):
            if time.monotonic() - started > settings.stage_limit_s:
                self._end_process(settings.stage_limit_s, settings.max_attempts)
                return
            try:
                self._stop_is_told = stop_requested.is_set()
                what = STOPPING if self._stop_is_told else self._what
                heartbeat(self._context.database, self._held, settings.lease_s, self._share, what)
                good_until = time.monotonic() + settings.lease_s
            except LeaseLostError:
                self._lost.set()
                return
            except DatabaseError as error:
                log.warning("heartbeat failed", error=str(error))
                if time.monotonic() > good_until:
                    self._lost.set()
                    return
