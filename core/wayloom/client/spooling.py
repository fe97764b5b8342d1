"""Watching of a spool folder: each complete log is uploaded, and dealt with when the server has accepted it."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from wayloom.client.api import Api
from wayloom.client.manifests import PackedDrive, pack
from wayloom.client.rates import UNLIMITED, RateLimit
from wayloom.client.spool import Record, Signature, Spool, Then, signature_of
from wayloom.client.upload import CONNECTIONS, upload
from wayloom.config.backoff import Backoff
from wayloom.config.progress import NamedProgress, silent_for_each
from wayloom.errors import InputError, NotFoundError, ServiceError

OFFLINE: Final = Backoff(first_s=5.0, longest_s=300.0)
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


def watch(api: Api, spool: Spool, watching: Watching, once: bool = False) -> None:
    """Upload what is complete, again and again; with `once` until nothing is left to be sent or waited for. Raises InputError."""
    failures = 0
    with spool.locked():
        while True:
            try:
                for log, signature in spool.complete():
                    _deal_with(api, spool, log, signature, watching)
                    failures = 0
            except ServiceError as error:
                failures += 1
                pause_s = watching.offline.pause_s(failures)
                watching.say(f"{error}; trying again in {pause_s:g} s")
                time.sleep(pause_s)
                continue
            if once and not spool.settling():
                return
            time.sleep(watching.poll_s)


def _deal_with(api: Api, spool: Spool, log: Path, signature: Signature, watching: Watching) -> None:
    """Upload one log, wait until it is accepted, then do with it what is to be done. Raises ServiceError."""
    try:
        drive = pack(log, vehicle_id=watching.vehicle, progress=watching.progress(f"{log.name}, reading"))
        upload(api, drive, watching.progress(f"{log.name}, sending"), watching.connections, limit=watching.limit)
        refusal = _refusal(api, drive, watching.poll_s)
    except InputError as error:
        refusal, drive = str(error), None
    if drive is None or refusal is not None:
        spool.record(log, Record(signature, None, refusal))
        watching.say(f"{log.name}: refused and left where it is: {refusal}")
        return
    if signature_of(log) != signature:
        watching.say(f"{log.name}: has changed while it was sent, and is sent again when it is complete")
        return
    spool.finish(log, signature, drive, watching.then, watching.target)
    watching.say(f"{log.name}: accepted as drive {drive.manifest.drive_id[:12]}")


def _refusal(api: Api, drive: PackedDrive, poll_s: float) -> str | None:
    """Wait until the server has opened the drive. Returns why it does not take it; None where it does."""
    while True:
        try:
            found = api.drive(drive.manifest.drive_id)
        except NotFoundError:
            return "it was removed on the server"
        accepted = any(stage["stage"] == ACCEPTED and stage["state"] == "done" for stage in found["stages"])
        if accepted:
            return None
        if found["state"] in ("failed", "removing"):
            return str(found["error"] or found["state"])
        time.sleep(poll_s)
