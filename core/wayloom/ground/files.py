"""Folder of ground sheets: `index.json` with the sheet of each submap, `<digest>.ground` with its content."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.ground.sheet import GroundSheet, decode_sheet

FORMAT: Final = "wayloom-ground"
VERSION: Final = 1
INDEX: Final = "index.json"
REMEDY: Final = "run the stage ground again"


def save_sheets(sheets: Iterable[GroundSheet], folder: Path) -> None:
    """Write the sheets as they come, one in memory at a time, then the index: a folder with an index is whole."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for sheet in sheets:
        write_atomically(sheet_file(folder, sheet.digest), sheet.encoded)
        entries.append({"submap": sheet.submap, "sheet": sheet.digest})
    text = json.dumps({"format": FORMAT, "version": VERSION, "sheets": entries}, indent=1, sort_keys=True)
    write_atomically(folder / INDEX, text.encode())


def sheet_file(folder: Path, digest: str) -> Path:
    """Where the sheet of this digest lies."""
    return folder / f"{digest}.ground"


def read_index(folder: Path) -> dict[str, str]:
    """Digest of the sheet of each submap's digest, in the order of the road. Raises InputError."""
    path = folder / INDEX
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
        if index["format"] != FORMAT or index["version"] != VERSION:
            raise ValueError(f"it is no {FORMAT} of version {VERSION}")
        return {str(entry["submap"]): str(entry["sheet"]) for entry in index["sheets"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no index of ground sheets ({error})", file=path, remedy=REMEDY) from error


def load_sheet(folder: Path, digest: str) -> GroundSheet:
    """One sheet. Raises InputError where it is missing or damaged."""
    path = sheet_file(folder, digest)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy=REMEDY) from error
    if hashlib.sha256(data).hexdigest() != digest:
        raise InputError("does not hold what its name says", file=path, remedy=REMEDY)
    return decode_sheet(data, str(path))
