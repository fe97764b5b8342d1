"""SHA-256 digests of files and of JSON values."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any


def sha256_of_file(file: Path) -> str:
    """Hex SHA-256 of a file's bytes, read in pieces."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sha256_of_json(value: Any) -> str:
    """Hex SHA-256 of a JSON-able value: keys sorted, no spaces."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def digest_of_files(root: Path, names: Iterable[str], known: Mapping[Path, str] = MappingProxyType({})) -> str:
    """One digest of files by their names relative to root and their bytes. known : by path, SHA-256 of what was read already."""
    return sha256_of_json([[name, known.get(root / name) or sha256_of_file(root / name)] for name in sorted(names)])
