"""Drive log of a run: opened once, with the version of the code that reads its format."""

from functools import cached_property
from pathlib import Path

from wayloom.logs.registry import LOG_FORMATS, open_log
from wayloom.logs.types import DriveLog
from wayloom.pipeline.code_version import code_version


class LogSource:
    """A log by its path, and the GNSS log kept elsewhere if there is one (as of `open_log`)."""

    def __init__(self, path: Path, gnss_path: Path | None = None) -> None:
        self.path, self.gnss_path = path, gnss_path

    @cached_property
    def log(self) -> DriveLog:
        """The log. Raises LogError, CalibrationError or UnknownFormatError."""
        return open_log(self.path, gnss=self.gnss_path)

    @cached_property
    def reader_version(self) -> str:
        """The version of the modules and libraries that read logs of this format."""
        reader = code_version(LOG_FORMATS[self.log.format].open.__module__)
        return reader.text
