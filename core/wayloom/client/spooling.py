"""Watching of a spool folder: each complete log is uploaded, and dealt with when the server has accepted it.

No log waits for another: not for one that the server refuses, nor for one that it has yet to open.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from wayloom.client.api import AnswerError, Api
from wayloom.client.manifests import PackedDrive, pack
from wayloom.client.rates import UNLIMITED, RateLimit
from wayloom.client.spool import Record, Signature, Spool, Then, signature_of
from wayloom.client.upload import CONNECTIONS, upload
from wayloom.config.backoff import Backoff
from wayloom.config.progress import NamedProgress, silent_for_each
from wayloom.errors import InputError, NotFoundError, ServiceError

OFFLINE: Final = Backoff(first_s=5.0, longest_s=300.0)
OF_EVERY_LOG: Final = frozenset({401, 404})
"""Refusals that do not depend on the log: the key, the address."""
FOR_NOW: Final = frozenset({408, 410, 423, 425, 429, 460})
"""Refusals that end by themselves, be it in an hour."""
QUOTA: Final = "quota-exceeded"
LEAST_QUOTA_S: Final = 5.0
LONGEST_QUOTA_S: Final = 3600.0
"""However long the server says: an operator may raise a quota."""
ACCEPTED: Final = "ingest"
"""The stage that opens a log and refuses a bad one: a drive that is past it is accepted."""


@dataclass(frozen=True, slots=True)
class Watching:
    """How a spool is watched.

    then, target : what becomes of an accepted log, and where it is moved to
    say          : called with a line on each thing that happens
    """

    then: Then = Then.KEEP
    target: Path | None = None
    vehicle: str | None = None
    connections: int = CONNECTIONS
    limit: RateLimit = UNLIMITED
    poll_s: float = 2.0
    offline: Backoff = OFFLINE
    progress: NamedProgress = silent_for_each
    say: Callable[[str], None] = field(default=lambda line: None)


@dataclass(frozen=True, slots=True)
class _Sent:
    """A log that the server has, as it was then, and has not opened yet."""

    log: Path
    signature: Signature
    drive: PackedDrive


def watch(api: Api, spool: Spool, watching: Watching, once: bool = False) -> None:
    """Upload what is complete, again and again; with `once` until nothing is left to be sent or waited for. Raises InputError."""
    failures, waiting, later = 0, dict[str, _Sent](), _Later(watching.say)
    with spool.locked():
        while True:
            try:
                for log, signature in spool.complete():
                    if log.name in waiting or later.holds(log):
                        continue
                    with later.on_quota(log):
                        if (sent := _send(api, spool, log, signature, watching)) is not None:
                            waiting[log.name] = sent
                    failures = 0
                for name in list(waiting):
                    if _is_dealt_with(api, spool, waiting[name], watching):
                        del waiting[name]
                    failures = 0
            except ServiceError as error:
                failures += 1
                pause_s = watching.offline.pause_s(failures)
                watching.say(f"{error}; trying again in {pause_s:g} s")
                time.sleep(pause_s)
                continue
            if once and not (waiting or spool.settling() or spool.complete()):
                return
            time.sleep(watching.poll_s)


class _Later:
    """Logs for which a quota is used up, and from when on each is tried again; another one, which is smaller, may go before."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._until = say, dict[str, float]()

    def holds(self, log: Path) -> bool:
        """Whether it is not its time yet."""
        return time.monotonic() < self._until.get(log.name, 0.0)

    @contextmanager
    def on_quota(self, log: Path) -> Iterator[None]:
        """Around the sending of a log."""
        try:
            yield
        except AnswerError as error:
            if error.code != QUOTA:
                raise
            pause_s = min(max(error.after_s, LEAST_QUOTA_S), LONGEST_QUOTA_S)
            self._until[log.name] = time.monotonic() + pause_s
            self._say(f"{log.name}: {error}; it waits for {pause_s:.0f} s, others do not")


def _send(api: Api, spool: Spool, log: Path, signature: Signature, watching: Watching) -> _Sent | None:
    """Upload one log; None where it is no log or the server refuses it. Raises ServiceError for what is not the log's fault."""
    try:
        drive = pack(log, vehicle_id=watching.vehicle, progress=watching.progress(f"{log.name}, reading"))
        upload(api, drive, watching.progress(f"{log.name}, sending"), watching.connections, limit=watching.limit)
    except InputError as error:
        _refuse(spool, log, signature, str(error), watching)
    except AnswerError as error:
        if not is_final(error):
            raise
        _refuse(spool, log, signature, str(error), watching)
    else:
        return _Sent(log, signature, drive)
    return None


def is_final(error: AnswerError) -> bool:
    """Whether the server has refused this log, and will again: neither every log alike, nor for now."""
    return 400 <= error.status < 500 and error.status not in OF_EVERY_LOG and error.status not in FOR_NOW


def _is_dealt_with(api: Api, spool: Spool, sent: _Sent, watching: Watching) -> bool:
    """Do with a log what is to be done, once the server has opened it. Raises ServiceError."""
    log, signature = sent.log, sent.signature
    try:
        found = api.drive(sent.drive.manifest.drive_id)
    except NotFoundError:
        _refuse(spool, log, signature, "it was removed on the server", watching)
        return True
    if not any(stage["stage"] == ACCEPTED and stage["state"] == "done" for stage in found["stages"]):
        if found["state"] not in ("failed", "removing"):
            return False
        _refuse(spool, log, signature, str(found["error"] or found["state"]), watching)
    elif signature_of(log) == signature and spool.finish(log, signature, sent.drive, watching.then, watching.target):
        watching.say(f"{log.name}: accepted as drive {sent.drive.manifest.drive_id[:12]}")
    else:
        watching.say(f"{log.name}: has changed while it was sent, and is sent again when it is complete")
    return True


def _refuse(spool: Spool, log: Path, signature: Signature, refusal: str, watching: Watching) -> None:
    spool.record(log, Record(signature, None, refusal))
    watching.say(f"{log.name}: refused and left where it is: {refusal}")
