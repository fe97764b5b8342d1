"""Folder of object sightings: `index.json` with those of each submap, `<digest>.objects` with their content."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.objects.types import ObjectSightings, decode_sightings

FORMAT: Final = "wayloom-objects"
VERSION: Final = 1
INDEX: Final = "index.json"
REMEDY: Final = "run the stage objects again"


def save_all(sightings: Iterable[ObjectSightings], folder: Path) -> None:
    """Write the sightings of each submap, then the index: a folder with an index is whole."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for one in sightings:
        write_atomically(sightings_file(folder, one.digest), one.encoded)
        entries.append({"submap": one.submap, "sightings": one.digest})
    text = json.dumps({"format": FORMAT, "version": VERSION, "sightings": entries}, indent=1, sort_keys=True)
    write_atomically(folder / INDEX, text.encode())


def sightings_file(folder: Path, digest: str) -> Path:
    """Where the sightings of this digest lie."""
    return folder / f"{digest}.objects"


def read_index(folder: Path) -> dict[str, str]:
    """Digest of the sightings of each submap's digest, in the order of the road. Raises InputError."""
    path = folder / INDEX
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
        if index["format"] != FORMAT or index["version"] != VERSION:
            raise ValueError(f"it is no {FORMAT} of version {VERSION}")
        return {str(entry["submap"]): str(entry["sightings"]) for entry in index["sightings"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no index of object sightings ({error})", file=path, remedy=REMEDY) from error


def load_one(folder: Path, digest: str) -> ObjectSightings:
    """The sightings along one submap. Raises InputError where they are missing or damaged."""
    path = sightings_file(folder, digest)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy=REMEDY) from error
    if hashlib.sha256(data).hexdigest() != digest:
        raise InputError("does not hold what its name says", file=path, remedy=REMEDY)
    return decode_sightings(data, str(path))
