"""Upload manifest of a drive log: its files with sizes and hashes."""

import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from wayloom.config.progress import Progress, silent
from wayloom.errors import LogError
from wayloom.files.regular import open_regular
from wayloom.logs.damage import without_damage
from wayloom.logs.registry import open_log_unchecked, refuse_links_out
from wayloom.logs.types import DriveLog
from wayloom.store.manifest import Manifest, ManifestFile

HASH_THREADS = 4


@dataclass(frozen=True, slots=True)
class PackedDrive:
    """A manifest and where each of its files is on this machine."""

    manifest: Manifest
    sources: dict[str, Path]


def pack(
    log_path: Path,
    gnss: Path | None = None,
    vehicle_id: str | None = None,
    progress: Progress = silent,
) -> PackedDrive:
    """Open the log, which refuses a bad one before a byte is sent, and hash its files.

    Single damaged images are sent as they are: the drive goes on without their frames, and says so.
    Raises InputError.
    """
    log = without_damage(open_log_unchecked(log_path, gnss=gnss))
    sources = {f"log/{name}": log.root / name for name in log.files}
    gnss_name, gnss_sources = _gnss_files(log, gnss)
    if gnss is not None:
        beside = gnss.resolve().parent
        refuse_links_out(gnss_sources.values(), beside.parent if gnss.name == "oxts" else beside)
    sources |= gnss_sources
    if not sources:
        raise LogError("has no files", file=log_path, remedy="give a drive log")
    files = _hashed(sources, progress)
    manifest = Manifest(
        name=log.name, vehicle_id=vehicle_id or log.vehicle_id, format=log.format, log=_log_name(log), gnss=gnss_name, files=files
    )
    return PackedDrive(manifest, sources)


def _log_name(log: DriveLog) -> str:
    """Path of the log itself below the folder that its files are relative to."""
    below = log.path.resolve().relative_to(log.root.resolve())
    return str(PurePosixPath("log", *below.parts))


def _gnss_files(log: DriveLog, gnss: Path | None) -> tuple[str | None, dict[str, Path]]:
    """The files of the GNSS log kept beside the drive, unless the log has them among its own."""
    if gnss is None:
        return None, {}
    gnss = gnss.resolve()
    gnss = gnss.parent if gnss.name == "oxts" else gnss
    if gnss.is_file():
        return f"gnss/{gnss.name}", {f"gnss/{gnss.name}": gnss}
    found = {f"gnss/{gnss.name}/{path.relative_to(gnss).as_posix()}": path for path in _gnss_folder_files(log, gnss)}
    if not found:
        raise LogError("has no files", file=gnss, remedy="give the folder of a GNSS log")
    beside = {f"gnss/{path.name}": path for path in sorted(gnss.parent.glob("calib*.txt"))}
    return f"gnss/{gnss.name}", found | beside


def _gnss_folder_files(log: DriveLog, gnss: Path) -> Iterator[Path]:
    """The folder's `oxts` part, or all of it: of packets numbered like frames only those of this log's frames."""
    part = gnss / "oxts" if (gnss / "oxts").is_dir() else gnss
    packets = {path for path in (part / "data").glob("*.txt") if path.stem.isdigit()}
    frames = {int(stem) for stem in (PurePosixPath(name).stem for name in log.files) if stem.isdigit()}
    wanted = {path for path in packets if int(path.stem) in frames} or packets
    for folder, _, names in os.walk(part):
        yield from sorted(path for path in (Path(folder) / name for name in names) if path not in packets or path in wanted)


def _hashed(sources: dict[str, Path], progress: Progress) -> tuple[ManifestFile, ...]:
    total, done = sum(path.stat().st_size for path in sources.values()), 0
    files = []
    with ThreadPoolExecutor(HASH_THREADS) as pool:
        for name, (size, digest) in zip(sources, pool.map(hash_file, sources.values()), strict=True):
            files.append(ManifestFile(path=name, size=size, sha256=digest))
            done += size
            progress(done / total if total else 1.0, f"{done / 1e6:.1f} of {total / 1e6:.1f} MB read")
    return tuple(files)


def hash_file(path: Path) -> tuple[int, str]:
    """Bytes and SHA-256 of a file. Raises LogError."""
    try:
        with open_regular(path) as file:
            return os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", file=path, remedy="check the file") from None
