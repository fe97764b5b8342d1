"""Doors of the Python API: open a drive log, process a drive."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

from wayloom.config.progress import NamedProgress, silent_for_each
from wayloom.config.sources import Option
from wayloom.logs import registry
from wayloom.logs.types import DriveLog
from wayloom.notebook.drive import Drive
from wayloom.pipeline.drive import process_drive
from wayloom.pipeline.settings import load_settings
from wayloom.pipeline.usable import check_usable
from wayloom.reports.drive_report import write_report

AnyPath = str | PathLike[str]


def open_log(path: AnyPath, gnss: AnyPath | None = None) -> DriveLog:
    """Open a drive log of any format; it is recognised by looking.

    path : a log's folder or file, or a folder that holds exactly one log
    gnss : a GNSS log kept elsewhere: a KITTI `…_sync` folder or a gnss.csv
    Raises LogError, CalibrationError or UnknownFormatError, each one line with file, record and remedy.
    """
    return registry.open_log(Path(path), gnss=None if gnss is None else Path(gnss))


def process(
    log: DriveLog | AnyPath,
    out: AnyPath,
    *,
    gnss: AnyPath | None = None,
    model: str | None = None,
    threads: int | None = None,
    settings: Mapping[str, object] | None = None,
    progress: NamedProgress = silent_for_each,
) -> Drive:
    """Map one drive into a folder, as `wayloom process` does. What an earlier call finished there is used again.

    gnss     : as of `open_log`; it has to be given again where the log was opened with it
    model    : network, as `--model`; threads: default all cores
    settings : by the dotted names of `wayloom config show`, such as {"merge.voxel_m": 0.2}
    progress : called with the name of each stage
    Raises InputError for a bad log, network or setting, and for a folder that cannot be written.
    """
    path, folder = Path(log if isinstance(log, str | PathLike) else log.path), Path(out)
    given = [Option("model", "segmentation.model", model), Option("threads", "threads", threads)]
    given += [Option(f"settings[{name!r}]", name, value) for name, value in (settings or {}).items()]
    loaded = load_settings(None, *given)
    check_usable(loaded)
    fixes = None if gnss is None else Path(gnss)
    process_drive(path, folder, loaded.settings.of_drives(), fixes, progress, write_report)
    return Drive(folder)
