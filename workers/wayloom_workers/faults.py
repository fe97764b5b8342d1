"""Faults of a job: which are the stage's own and use up an attempt, which are the machine's, and what a crash leaves behind."""

import errno
import faulthandler
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from sqlalchemy.exc import OperationalError

from wayloom.store.blobs import BlobError
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
OWN_SHARE: Final = 0.25
"""Share of the machine's memory from which on a stage that gets no more is itself to blame."""


def of_the_machine(error: BaseException) -> str | None:
    """Why the error, or what it came from, says nothing of the stage and would have met any other; None where it is the stage's."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, OperationalError):
            return "the database does not answer"
        if isinstance(seen, BlobError):
            return "the object store does not answer"
        if isinstance(seen, MemoryError) and _memory_share() < OWN_SHARE:
            return MACHINE_ERRORS[errno.ENOMEM]
        if isinstance(seen, OSError) and (words := MACHINE_ERRORS.get(seen.errno or 0)) is not None:
            return words
        seen = seen.__cause__
    return None


def _memory_share() -> float:
    """Of the machine's memory, the share that this process holds; 1 where the system does not say."""
    try:
        resident = int(Path("/proc/self/statm").read_text().split()[1])
        return resident / os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return 1.0


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
