"""Registry of the drive log formats (`LOG_FORMATS`), and recognition of a log's format from its files."""

import itertools
import os
import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wayloom.errors import ConfigError, LogError, UnknownFormatError
from wayloom.files.links import leading_out
from wayloom.logs.euroc import euroc_log
from wayloom.logs.kitti import kitti_360, kitti_odometry, kitti_raw
from wayloom.logs.ros2 import mcap_log
from wayloom.logs.types import DriveLog, StoredLog

NAMED: Final = 5
"""Logs that an error lists."""
LEVELS: Final = 4
"""How deep logs are looked for below a folder that is none."""
MOST_LOOKED: Final = 2000
"""Entries that are looked at for it."""


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A log format: its characteristic files (in words), the test that recognises a folder, and the function that opens it."""

    looks_for: str
    recognise: Callable[[Path], bool]
    open: Callable[[Path, Path | None], StoredLog]


LOG_FORMATS: Final[dict[str, LogFormat]] = {
    kitti_360.FORMAT: LogFormat(kitti_360.LOOKS_FOR, kitti_360.recognise, kitti_360.open_kitti_360),
    kitti_odometry.FORMAT: LogFormat(kitti_odometry.LOOKS_FOR, kitti_odometry.recognise, kitti_odometry.open_kitti_odometry),
    kitti_raw.FORMAT: LogFormat(kitti_raw.LOOKS_FOR, kitti_raw.recognise, kitti_raw.open_kitti_raw),
    euroc_log.FORMAT: LogFormat(euroc_log.LOOKS_FOR, euroc_log.recognise, euroc_log.open_euroc),
    mcap_log.FORMAT: LogFormat(mcap_log.LOOKS_FOR, mcap_log.recognise, mcap_log.open_mcap),
}


def open_log(path: Path, *, gnss: Path | None = None) -> DriveLog:
    """Open a drive log. The ends and headers of all images are looked at, none is decoded.

    path : a log's folder or file, or a folder that holds exactly one log
    gnss : a KITTI `…_sync` folder or its oxts folder, whose packet n belongs to the frame numbered n, or a gnss.csv on the
           clock of the frames; None takes what lies in the log

    Raises LogError, CalibrationError or UnknownFormatError, each one line with file, record and remedy.
    """
    log = open_log_unchecked(path, gnss=gnss)
    log.check_headers()
    return log


def open_log_unchecked(path: Path, *, gnss: Path | None = None) -> StoredLog:
    """`open_log`, but only the first image is looked at."""
    folder = find_log(absolute(path))
    key = next(key for key, log_format in LOG_FORMATS.items() if log_format.recognise(folder))
    log = LOG_FORMATS[key].open(folder, None if gnss is None else absolute(gnss))
    check_inside(log)
    return log


def check_inside(log: DriveLog) -> None:
    """Raises LogError where a file of the log is a symbolic link, or lies behind one, that leads out of the log's folder."""
    refuse_links_out((log.root / name for name in log.files), log.root)


def refuse_links_out(files: Iterable[Path], root: Path) -> None:
    """Raises LogError where one of the files below `root` is a link, or lies behind one, to what lies elsewhere: nobody has asked
    for that to be read or sent."""
    if (file := next(leading_out(files, root), None)) is not None:
        raise LogError(
            f"is or lies behind a symbolic link that leads out of {root}, to {os.path.realpath(file)}",
            file=file,
            remedy="put the file itself there, or take the link away",
            reason="file.outside",
        )


def absolute(path: Path) -> Path:
    """The absolute path without `..`; symbolic links stay, because calibration may lie beside the link."""
    return Path(os.path.abspath(path))


def check_outside(log: DriveLog, *outputs: Path | None) -> None:
    """Raises ConfigError where an output is the log's folder or lies in it: nothing is ever written into a log."""
    folder = log.path.resolve()
    for output in outputs:
        if output is not None and folder in (place := output.resolve(), *place.parents):
            raise ConfigError(
                f"lies inside the log {log.path}", file=output, remedy="choose a place outside: a log stays as it was recorded"
            )


def find_log(path: Path) -> Path:
    """The folder or file that is a log: `path`, or the only one inside it. Raises LogError or UnknownFormatError."""
    try:
        if not path.exists():
            raise LogError("no such folder", file=path, remedy="give the path of a drive log", reason="file.missing")
        if _recognised(path):
            return path
        if not path.is_dir():
            raise UnknownFormatError(f"is a file; {known()}", file=path, remedy="give a log's folder")
        inside = sorted(path.iterdir())
        logs = [entry for entry in inside if _recognised(entry)]
    except OSError as problem:
        raise LogError(f"cannot be read ({problem.strerror})", file=path, remedy="check the folder's permissions") from None
    if len(logs) == 1:
        return logs[0]
    if logs:
        raise UnknownFormatError(f"holds {len(logs)} logs ({_named(logs, path)})", file=path, remedy=_inspect(logs[0]))
    if not inside:
        raise UnknownFormatError(f"the folder is empty; {known()}", file=path, remedy="give a log's folder")
    if below := logs_below(path):
        raise UnknownFormatError(f"is no log, but logs lie below it ({_named(below, path)})", file=path, remedy=_inspect(below[0]))
    raise UnknownFormatError(f"no known log format; {known()}", file=path, remedy="give the folder that holds them")


def logs_below(path: Path) -> list[Path]:
    """The first logs with images below a folder that is none, NAMED and one at most, the least deep first.

    LEVELS and MOST_LOOKED bound the search; it follows no links.
    """
    looked = itertools.islice(_below(path), MOST_LOOKED)
    return list(itertools.islice((entry for entry in looked if _is_log_on_its_own(entry)), NAMED + 1))


def _below(path: Path) -> Iterator[Path]:
    """What lies below a folder, level by level and by name; nothing hidden, nothing in logs, of a folder MOST_LOOKED at most."""
    level = [path]
    for _ in range(LEVELS):
        folders: list[Path] = []
        for folder in level:
            for entry in _entries(folder):
                yield entry
                if entry.is_dir() and not entry.is_symlink() and not _is_log_on_its_own(entry):
                    folders.append(entry)
        level = folders


def _entries(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            some = itertools.islice(entries, MOST_LOOKED)
            return sorted(Path(entry.path) for entry in some if not entry.name.startswith("."))
    except OSError:  # may not be read
        return []


def _is_log_on_its_own(path: Path) -> bool:
    """Whether a path is a log with images. Of recordings the file counts: to look for it in each folder would list them all."""
    formats = (log_format for key, log_format in LOG_FORMATS.items() if key not in (mcap_log.FORMAT, kitti_raw.FORMAT))
    try:
        if path.suffix.lower() == mcap_log.ENDING and path.is_file():
            return True
        return kitti_raw.has_image_folder(path) or any(log_format.recognise(path) for log_format in formats)
    except OSError:  # may not be looked at
        return False


def _named(logs: list[Path], path: Path) -> str:
    return ", ".join(str(log.relative_to(path)) for log in logs[:NAMED]) + (", …" if len(logs) > NAMED else "")


def _inspect(log: Path) -> str:
    return f"give one of them, as wayloom inspect {shlex.quote(str(log))}"


def known() -> str:
    """The known formats and the files by which each is recognised, as part of an error message."""
    return "known are " + "; ".join(f"{key} ({log_format.looks_for})" for key, log_format in LOG_FORMATS.items())


def _recognised(folder: Path) -> bool:
    return any(log_format.recognise(folder) for log_format in LOG_FORMATS.values())
