"""Download of a network of the catalogue, checked by its SHA-256 and written atomically."""

import hashlib
import tempfile
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from wayloom.config.progress import Progress, silent
from wayloom.errors import ModelError
from wayloom.files.atomic import write_atomically
from wayloom.segmentation.conversion.convert import builder_of, convert
from wayloom.segmentation.description import ModelDescription

MAX_BYTES: Final = 4 * 2**30
_PART: Final = 1 << 20
_TIMEOUT_S: Final = 60


def fetch(description: ModelDescription, folder: Path, progress: Progress = silent) -> Path:
    """Get the network's file into `folder`, as the description's `file` names it, and return its path.

    Weights that are published in another form are converted. What comes is checked by its SHA-256 before it is opened.
    Raises ModelError where the description names no place, the place does not answer, or something else comes;
    MissingExtraError where the weights are to be converted and the packages for that are not installed.
    """
    if description.url is None:
        raise ModelError(
            f"network {description.name} names no place to fetch it from", remedy=description.source or "see its source"
        )
    if description.conversion is not None:
        builder_of(description.conversion)  # what cannot be converted is told before it is fetched
    path = folder / description.file
    path.parent.mkdir(parents=True, exist_ok=True)
    if description.conversion is None:
        write_atomically(path, _checked(description.url, description.sha256, path.parent, progress))
        return path
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        weights = Path(scratch) / "weights.pt"
        write_atomically(weights, _checked(description.url, description.url_sha256, Path(scratch), progress))
        convert(description.conversion, weights, path)
    return path


def _checked(url: str, sha256: str | None, folder: Path, progress: Progress) -> bytes:
    """The bytes at the URL. They go to a file first, so that a wrong length costs no memory."""
    digest = hashlib.sha256()
    with tempfile.TemporaryFile(dir=folder) as file:
        for part in _parts(url, progress):
            digest.update(part)
            file.write(part)
        if digest.hexdigest() != sha256:
            raise ModelError(f"SHA-256 is {digest.hexdigest()}, not {sha256}", file=url, remedy="another file lies there now")
        file.seek(0)
        return file.read()


def _parts(url: str, progress: Progress) -> Iterator[bytes]:
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S) as answer:  # noqa: S310 (http and https only: the description's pattern)
            length = int(answer.headers.get("Content-Length") or 0)
            done = 0
            while part := answer.read(_PART):
                done += len(part)
                if done > MAX_BYTES:
                    raise ModelError(f"more than {MAX_BYTES} bytes", file=url, remedy="no network is so large")
                progress(min(1.0, done / length) if length else 0.0, f"fetched {done / 1e6:.1f} MB")
                yield part
    except (urllib.error.URLError, TimeoutError, OSError) as error:
        raise ModelError(
            f"cannot be fetched ({error})", file=url, remedy="check the connection, or get the file by hand"
        ) from error
