"""The cache of compiled kernels, one folder for each state of the kernels' sources, and how several processes fill it.

numba renews a kernel when that kernel's own file changes, but not when a kernel that it calls, in another file, does. So an updated
tree could run old code. A cache named after a hash of every kernel's source cannot.
"""

import atexit
import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wayloom.config.progress import Progress, silent

POLL_S: Final = 0.2


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


@dataclass(frozen=True, slots=True)
class KernelGroup:
    """Kernels that one process compiles at a stretch, because they share parts.

    kernels : each with the types of its arguments; called only where something is to be compiled
    size : how many they are
    """

    name: str
    kernels: Callable[[], Sequence[tuple[Any, tuple[Any, ...]]]]
    size: int


def lacking(groups: Sequence[KernelGroup]) -> list[KernelGroup]:
    """Those of which the cache does not hold everything; none where numba's compiler is off."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return []
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    return [group for group in groups if not _mark(folder, group).exists()]


def compile_kernels(groups: Sequence[KernelGroup], progress: Progress = silent, begin: Callable[[], None] = lambda: None) -> int:
    """Compile what the cache does not hold yet, and say which of how many kernels it is; returns how many that were.

    begin : called before each kernel
    Of several processes each takes groups that no other one works on, and waits for the rest: nothing is compiled twice.
    """
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    waiting = lacking(groups)
    if not waiting:
        return 0
    folder.mkdir(parents=True, exist_ok=True)
    done, total = 0, sum(group.size for group in waiting)
    while waiting:
        for group in tuple(waiting):
            with _lock(_mark(folder, group).with_suffix(".lock")) as is_ours:
                if not is_ours:
                    continue
                waiting.remove(group)
                if _mark(folder, group).exists():  # by now
                    continue
                for kernel, types in group.kernels():
                    begin()
                    progress(0.0, f"compiling kernels, {done + 1} of {total} (first run only)")
                    kernel.compile(types)
                    done += 1
                _mark(folder, group).touch()
        if waiting:
            progress(0.0, f"compiling kernels, {done} of {total}: another process works on the others (first run only)")
            time.sleep(POLL_S)
    return done


def _mark(folder: Path, group: KernelGroup) -> Path:
    """The file that says that a group is compiled, by this numba for this processor, from sources in this place."""
    import llvmlite.binding
    import numba

    state = f"{numba.__version__} {sys.version} {llvmlite.binding.get_host_cpu_name()} {__file__}"
    return folder / f"{group.name}-{hashlib.sha256(state.encode()).hexdigest()[:16]}.compiled"


@contextlib.contextmanager
def _lock(file: Path) -> Iterator[bool]:
    """Whether nobody else holds the lock; if so it is held within the context."""
    import fcntl

    with file.open("a") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
            return
        yield True
