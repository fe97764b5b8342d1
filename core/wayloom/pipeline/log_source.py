"""Drive log of a run: opened once, with the version of the code that reads its format."""

from functools import cached_property
from pathlib import Path

from wayloom.logs.damage import without_damage, without_frames
from wayloom.logs.registry import LOG_FORMATS, open_log_unchecked
from wayloom.logs.types import DriveLog
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.log_parts import LOG_FILE, rejected_frames


class LogSource:
    """A log by its path, and the GNSS log kept elsewhere if there is one (as of `open_log`)."""

    def __init__(self, path: Path, gnss_path: Path | None = None) -> None:
        self.path, self.gnss_path = path, gnss_path
        self._ingested: tuple[Path, tuple[int, int, int]] | None = None
        self._reduced: DriveLog | None = None

    @cached_property
    def log(self) -> DriveLog:
        """The log, without the frames whose image files are cut or empty. Raises LogError, CalibrationError, UnknownFormatError."""
        return without_damage(open_log_unchecked(self.path, gnss=self.gnss_path))

    def log_after(self, ingest: Path) -> DriveLog:
        """`log` without the frames that the ingest stage, whose folder this is, left out; all of it where that has not run."""
        found = ingest, _stamp(ingest / LOG_FILE)
        if self._reduced is None or self._ingested != found:
            rejected = rejected_frames(ingest)
            self._ingested, self._reduced = found, without_frames(self.log, rejected) if rejected else self.log
        return self._reduced

    @cached_property
    def reader_version(self) -> str:
        """The version of the modules and libraries that read logs of this format."""
        reader = code_version(LOG_FORMATS[self.log.format].open.__module__)
        return reader.text


def _stamp(file: Path) -> tuple[int, int, int]:
    """By what it is seen that a file was written anew; zeros where it is not there."""
    try:
        found = file.stat()
    except OSError:
        return (0, 0, 0)
    return found.st_ino, found.st_mtime_ns, found.st_size
