"""Faults of a job: which are the stage's own and use up an attempt, which are the machine's, and what a crash leaves behind."""

import errno
import faulthandler
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from wayloom.config.machine import machine_memory
from wayloom.store.blobs import BlobError
from wayloom.store.database import DatabaseAwayError
from wayloom.store.folders import Folders
from wayloom.store.jobs import Claim

CRASH_FILE: Final = "crash.txt"
CRASH_LENGTH: Final = 1500
MACHINE_ERRORS: Final = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EIO: "the disk does not answer",
    errno.ESTALE: "the data folder is away",
    errno.ENOTCONN: "the data folder is away",
    errno.ENOMEM: "the machine has no memory left",
    errno.EAGAIN: "the machine has no threads left",
    errno.ENFILE: "the machine has too many files open",
}
WORKER_SHARE: Final = 0.8
"""Of the machine's memory, which a worker may hold unless a setting says otherwise: what is left keeps the system, the database and
the API alive, so that it is the stage that is told, not a neighbour that is killed."""
OWN_SHARE: Final = 0.25
"""Share of the machine's memory from which on a stage that gets no more is itself to blame."""
CROWDED_SHARE: Final = 0.1
"""Share of the machine's memory below which what is free is too little for anybody."""


def of_the_machine(error: BaseException) -> str | None:
    """Why the error, or what it came from, says nothing of the stage and would have met any other; None where it is the stage's."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, DatabaseAwayError):
            return "the database does not answer"
        if isinstance(seen, BlobError):
            return "the object store does not answer"
        if isinstance(seen, MemoryError) and _others_hold_the_memory():
            return MACHINE_ERRORS[errno.ENOMEM]
        if isinstance(seen, OSError) and (words := MACHINE_ERRORS.get(seen.errno or 0)) is not None:
            return words
        seen = seen.__cause__
    return None


def _others_hold_the_memory() -> bool:
    """Whether the machine has hardly any memory left, and this process holds little of it; False where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        found = {name: int(value.split()[0]) << 10 for name, _, value in (line.partition(":") for line in lines)}
        own = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        return found["MemAvailable"] < CROWDED_SHARE * found["MemTotal"] and own < OWN_SHARE * found["MemTotal"]
    except (OSError, ValueError, KeyError):
        return False


def limit_memory(most: int) -> None:
    """Let this process hold no more than so many bytes of its own; a stage that wants more gets MemoryError, and nobody else's
    process is killed for it. -1: WORKER_SHARE of what the machine or its control group has; 0: as much as there is."""
    if most < 0:
        most = int(WORKER_SHARE * machine_memory())
    if most:
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def attempt_folder(folders: Folders, held: Claim) -> Path:
    """Where an attempt of the job writes."""
    home = folders.map(held.map_id) if held.map_id is not None else folders.drive(str(held.drive_id))
    return home / "attempts" / f"{held.stage}-{held.job_id}-{held.token}"


@contextmanager
def crash_report(folder: Path) -> Iterator[None]:
    """Within the block a crash of this process (a bad address, an abort) leaves its traceback in the attempt's folder."""
    folder.mkdir(parents=True, exist_ok=True)
    before = faulthandler.is_enabled()
    with (folder / CRASH_FILE).open("w") as file:
        faulthandler.enable(file, all_threads=False)
        try:
            yield
        finally:
            faulthandler.enable() if before else faulthandler.disable()


def crash_of(folders: Folders, held: Claim) -> str:
    """What the attempt's process left when it crashed; empty where it was killed from outside, or cannot be asked."""
    try:
        with (attempt_folder(folders, held) / CRASH_FILE).open(encoding="utf-8", errors="replace") as file:
            return file.read(CRASH_LENGTH).strip()
    except OSError:
        return ""
