"""Spool folder of a vehicle: logs that are uploaded as soon as they are complete, and then kept, moved or deleted.

SPOOL/NAME             a log: a folder or a file whose name does not begin with a dot
SPOOL/NAME.complete    says that it is complete, at once; without it a log is complete when nothing in it has changed for a while
SPOOL/.wayloom/        NAME.json: what the server has said of the log as it was then; lock. May be deleted: it is found out anew

Whether a log changes is judged by its files' sizes and time stamps and a clock that only counts on: a vehicle's may be wrong.
"""

import errno
import fcntl
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from wayloom.client.manifests import PackedDrive
from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically

OWN: Final = ".wayloom"
MARKER: Final = ".complete"


class Then(StrEnum):
    """What becomes of a log that the server has accepted."""

    KEEP = "keep"
    DELETE = "delete"
    MOVE = "move"


@dataclass(frozen=True, slots=True)
class Signature:
    """By what it is seen that a log changes: how many files it has, their bytes, the newest time stamp."""

    files: int
    bytes: int
    newest_ns: int


@dataclass(frozen=True, slots=True)
class Record:
    """What is known of a log that was as `signature` says: accepted, or refused for a reason.

    deleting : files in it, by path, that were accepted and are being deleted: what a reboot leaves of them is no log
    """

    signature: Signature
    drive: str | None
    refused: str | None
    deleting: tuple[str, ...] = ()


class Spool:
    """The folder. Only one process at a time may have it (`locked`).

    settle_s : seconds without a change after which a log without a marker is complete
    """

    def __init__(self, root: Path, settle_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.root, self._settle_s, self._clock = root, settle_s, clock
        self._seen: dict[str, tuple[Signature, float]] = {}

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep others away. Raises InputError where another process has the folder, or where none is."""
        if not self.root.is_dir():
            raise InputError("is no folder", file=self.root, remedy="give the folder into which the logs are written")
        (self.root / OWN).mkdir(exist_ok=True)
        with (self.root / OWN / "lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError("is being watched by another process", file=self.root, remedy="end that one") from None
            for found in sorted((self.root / OWN).glob("*.json")):
                self._delete(self.root / found.name.removesuffix(".json"))
            yield

    def complete(self) -> list[tuple[Path, Signature]]:
        """Logs that are complete and of which nothing is known as they are. To be asked again and again: time counts between."""
        return [
            (log, signature) for log, signature in self._logs() if self._settled(log, signature) and not self._known(log, signature)
        ]

    def settling(self) -> bool:
        """Whether a log is there that may still be written."""
        return any(not self._settled(log, signature) for log, signature in self._logs() if not self._known(log, signature))

    def record(self, log: Path, record: Record) -> None:
        """Remember what the server has said."""
        write_atomically(self._record(log), (json.dumps(asdict(record), indent=1) + "\n").encode())

    def known(self, log: Path) -> Record | None:
        """What it has said, None where that is not known or not readable."""
        try:
            read: dict[str, Any] = json.loads(self._record(log).read_text(encoding="utf-8"))
            return Record(Signature(**read["signature"]), read["drive"], read["refused"], tuple(read["deleting"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def finish(self, log: Path, signature: Signature, drive: PackedDrive, then: Then, target: Path | None) -> bool:
        """Do what is to be done with a log that was accepted. Deleted are files that were sent, and folders that are empty then.

        Whether it is done: not where the log has changed while it was copied, which leaves everything as it was.
        """
        accepted = Record(signature, drive.manifest.drive_id, None)
        if then is Then.MOVE and target is not None:
            return self._move(log, accepted, target)
        self.record(log, replace(accepted, deleting=_sent(log, drive) if then is Then.DELETE else ()))
        self._delete(log)
        return True

    def _move(self, log: Path, accepted: Record, target: Path) -> bool:
        """Move it, to another file system by a copy. Nothing is deleted before that is whole, durable and of the log as it is."""
        if not _renamed(log, target):
            found = tuple(os.path.relpath(path, log) for path in _files(log))
            copied = _copy(log, target)
            if signature_of(log) != accepted.signature:
                _remove(copied)
                return False
            os.rename(copied, _free_name(target / log.name))
            os.sync()
            self.record(log, replace(accepted, deleting=found))
        self._delete(log)
        return True

    def _delete(self, log: Path) -> None:
        """Delete what is marked for it; what is left then is known, and no new log."""
        record = self.known(log)
        if record is not None and record.deleting:
            for path in record.deleting:
                (log / path).unlink(missing_ok=True)
            if log.is_dir():
                _remove_empty(log)
            self._marker(log).unlink(missing_ok=True)
            if log.exists():
                self.record(log, replace(record, signature=signature_of(log), deleting=()))
        if not log.exists():
            self._marker(log).unlink(missing_ok=True)
            self._record(log).unlink(missing_ok=True)

    def _logs(self) -> Iterator[tuple[Path, Signature]]:
        for log in sorted(self.root.iterdir()):
            if not log.name.startswith(".") and not log.name.endswith(MARKER):
                signature = signature_of(log)
                if signature.files:
                    yield log, signature

    def _settled(self, log: Path, signature: Signature) -> bool:
        if self._marker(log).exists():
            return True
        before, since = self._seen.get(log.name, (None, 0.0))
        if before != signature:
            self._seen[log.name] = signature, (since := self._clock())
        return self._clock() - since >= self._settle_s

    def _known(self, log: Path, signature: Signature) -> bool:
        record = self.known(log)
        return record is not None and record.signature == signature

    def _marker(self, log: Path) -> Path:
        return log.with_name(log.name + MARKER)

    def _record(self, log: Path) -> Path:
        return self.root / OWN / f"{log.name}.json"


def signature_of(log: Path) -> Signature:
    """Of a log's files as they are now. What vanishes meanwhile is not there."""
    files, count, newest = 0, 0, 0
    for path in _files(log):
        try:
            found = os.lstat(path)
        except FileNotFoundError:
            continue
        files, count, newest = files + 1, count + found.st_size, max(newest, found.st_mtime_ns)
    return Signature(files, count, newest)


def _files(log: Path) -> Iterator[str]:
    if not log.is_dir() or log.is_symlink():
        yield str(log)
    else:
        for folder, _, names in os.walk(log):
            yield from (os.path.join(folder, name) for name in names)


def _sent(log: Path, drive: PackedDrive) -> tuple[str, ...]:
    """The files in the log, by path, that the drive was made of."""
    root = log.resolve()
    sources = [source.resolve() for source in drive.sources.values()]
    return tuple(path.relative_to(root).as_posix() for path in sources if path.is_relative_to(root))


def _remove_empty(log: Path) -> None:
    for folder, _, _ in os.walk(log, topdown=False):
        if not os.listdir(folder):
            os.rmdir(folder)


def _renamed(log: Path, target: Path) -> bool:
    """Whether the log could be moved in one step; not to another file system."""
    try:
        os.rename(log, _free_name(target / log.name))
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        return False
    return True


def _copy(log: Path, target: Path) -> Path:
    """A copy beside its place, durable, under the hidden name that it has until it is known to be whole."""
    unfinished = target / f".{log.name}.unfinished"
    target.mkdir(parents=True, exist_ok=True)
    _remove(unfinished)
    if log.is_dir():
        shutil.copytree(log, unfinished, symlinks=True)
    else:
        shutil.copy2(log, unfinished)
    os.sync()
    return unfinished


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _free_name(wanted: Path) -> Path:
    """The name, or the first with a number behind it that nothing has."""
    wanted.parent.mkdir(parents=True, exist_ok=True)
    numbers = (wanted.with_name(f"{wanted.name}-{number}") for number in range(2, 1_000_000))
    return wanted if not wanted.exists() else next(name for name in numbers if not name.exists())
