"""Files that are either whole or not there."""

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path


def write_atomically(file: Path, data: bytes | Iterable[bytes]) -> None:
    """Write to a temporary name beside `file`, then put it in place in one step. Missing parent folders are made."""
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{file.name}.", dir=file.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            for part in (data,) if isinstance(data, bytes) else data:
                stream.write(part)
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, file)
    except BaseException:
        os.unlink(name)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
