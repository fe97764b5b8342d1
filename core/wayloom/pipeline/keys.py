"""When a finished stage may be used again: its key is a hash of its inputs' contents, its parameters and the code's version.

Inputs count by content, so a stage that was redone with the same result does not make the next ones run again.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import wayloom

STAGE_FILE: Final = "stage.json"
REPORT_FILE: Final = "report.json"
PACKAGE: Final = Path(wayloom.__file__).parent


def sha256_of_file(file: Path) -> str:
    """Hex SHA-256 of a file's bytes, read in pieces."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sha256_of_json(value: Any) -> str:
    """Hex SHA-256 of a JSON-able value: keys sorted, no spaces."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def digest_of_files(root: Path, names: Iterable[str]) -> str:
    """One digest of files by their names relative to root and their bytes."""
    return sha256_of_json([[name, sha256_of_file(root / name)] for name in sorted(names)])


def digest_of_folder(folder: Path) -> str:
    """One digest of all that later stages read from a stage's folder. Its reports (times and the like) do not count."""
    names = (file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
    return digest_of_files(folder, (name for name in names if name not in (STAGE_FILE, REPORT_FILE)))


@lru_cache
def code_version(rooms: tuple[str, ...]) -> str:
    """The version of wayloom and a digest of the source of these rooms (`odometry`) or modules (`pipeline/stages.py`)."""
    files: list[Path] = []
    for room in rooms:
        place = PACKAGE / room
        files += [place] if place.is_file() else sorted(place.rglob("*.py"))
    return f"{wayloom.__version__}+{digest_of_files(PACKAGE, (file.relative_to(PACKAGE).as_posix() for file in files))[:16]}"


def stage_key(stage: str, inputs: Mapping[str, str], parameters: Mapping[str, Any], version: str) -> str:
    """Hex SHA-256. inputs : name to content digest; parameters : JSON-able."""
    return sha256_of_json({"stage": stage, "inputs": dict(inputs), "parameters": dict(parameters), "code": version})


def read_stage_file(folder: Path) -> dict[str, Any] | None:
    """What a finished stage says of itself: key, digest, seconds …; None where it is not finished or not readable."""
    try:
        said = json.loads((folder / STAGE_FILE).read_text())
    except (OSError, ValueError):
        return None
    return said if isinstance(said, dict) and {"key", "digest", "seconds"} <= said.keys() else None


def is_undamaged(folder: Path) -> bool:
    """Whether a finished stage's files are still those that it left: a disk may lose what a stage.json outlives."""
    said = read_stage_file(folder)
    return said is not None and digest_of_folder(folder) == said["digest"]
