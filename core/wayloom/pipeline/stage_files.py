"""Folder of a finished stage: its result, the report that does not count, and stage.json, written last, that says it is whole.

Inputs count by content (`digest_of_folder`), so a stage that was redone with the same result does not make the next ones run again.
"""

import json
from pathlib import Path
from typing import Any, Final

from wayloom.pipeline.digests import digest_of_files
from wayloom.pipeline.stage_report import REPORT_FILE

STAGE_FILE: Final = "stage.json"


def digest_of_folder(folder: Path) -> str:
    """One digest of all that later stages read from a stage's folder. Its reports (times and the like) do not count."""
    names = (file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
    return digest_of_files(folder, (name for name in names if name not in (STAGE_FILE, REPORT_FILE)))


def read_stage_file(folder: Path) -> dict[str, Any] | None:
    """The metadata of a finished stage: key, digest, seconds …; None where it is not finished or not readable."""
    try:
        metadata = json.loads((folder / STAGE_FILE).read_text())
    except (OSError, ValueError):
        return None
    return metadata if isinstance(metadata, dict) and {"key", "digest", "seconds"} <= metadata.keys() else None


def finished_key(folder: Path) -> str | None:
    """The key of the result in this folder; None where there is none, or only part of one."""
    metadata = read_stage_file(folder)
    return None if metadata is None else str(metadata["key"])


def is_undamaged(folder: Path) -> bool:
    """Whether a finished stage's files are still those that it left: a disk may lose what a stage.json outlives."""
    metadata = read_stage_file(folder)
    return metadata is not None and digest_of_folder(folder) == metadata["digest"]
