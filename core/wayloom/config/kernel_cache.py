"""Where compiled kernels are kept: one folder for each state of the kernels' sources.

numba renews a kernel when that kernel's own file changes, but not when a kernel that it calls, in another file, does. So an updated
tree could run old code. A cache named after a hash of every kernel's source cannot.
"""

import atexit
import hashlib
import os
import shutil
import tempfile
from pathlib import Path


def kernel_digest(package: Path) -> str:
    """Sixteen hexadecimal digits of a hash of every `kernels/*.py` under the package's folder."""
    sources = sorted(package.glob("*/kernels/*.py"))
    digest = hashlib.sha256()
    for source in sources:
        content = source.read_bytes()
        digest.update(f"{source.relative_to(package).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


def use_kernel_cache(package: Path) -> None:
    """Point numba to the cache of these sources, unless NUMBA_CACHE_DIR says otherwise. Called before numba is imported.

    Where that folder cannot be written, numba would refuse to compile: then the cache is a folder that goes with the process.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = os.environ.get("NUMBA_CACHE_DIR") or str(Path(home) / "wayloom" / f"kernels-{kernel_digest(package)}")
    if not can_be_written(Path(folder)):
        folder = tempfile.mkdtemp(prefix="wayloom-kernels-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = folder


def can_be_written(folder: Path) -> bool:
    """Whether files can be made in a folder, or the folder itself; it is not made."""
    nearest = next((place for place in (folder, *folder.absolute().parents) if os.path.lexists(place)), folder)
    return os.path.isdir(nearest) and os.access(nearest, os.W_OK | os.X_OK)
