"""Made-up drives."""

import hashlib
import json
from pathlib import Path

import numpy as np

from wayloom.client.manifests import PackedDrive
from wayloom.store.manifest import Manifest, ManifestFile


def packed_drive(
    folder: Path, name: str = "drive", play: dict[str, object] | None = None, sizes: tuple[int, ...] = (1000, 0)
) -> PackedDrive:
    """A drive with files of these sizes and a `play.json` that says what its stages shall do."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(sum(name.encode()))
    contents = {f"log/image_0/{i:06}.png": rng.bytes(size) for i, size in enumerate(sizes)}
    contents["log/play.json"] = json.dumps(play or {}).encode()
    return packed_drive_of(folder, name, contents)


def packed_drive_of(folder: Path, name: str, contents: dict[str, bytes]) -> PackedDrive:
    """A drive of these files."""
    sources, files = {}, []
    for path, content in contents.items():
        sources[path] = folder / hashlib.sha256(path.encode()).hexdigest()
        sources[path].write_bytes(content)
        files.append(ManifestFile(path=path, size=len(content), sha256=hashlib.sha256(content).hexdigest()))
    return PackedDrive(Manifest(name=name, files=tuple(files)), sources)
