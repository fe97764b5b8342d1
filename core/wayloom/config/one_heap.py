"""Heaps that threads take their memory from.

glibc gives threads heaps of their own, and what was freed in one is used by no other: the more threads, the more is held in vain.
Kernels allocate nothing, so threads hardly wait for one heap.
"""

import ctypes
import os
import sys
from typing import Final

VARIABLE: Final = "MALLOC_ARENA_MAX"
M_ARENA_MAX: Final = -8
"""Of glibc's malloc.h."""


def use_one_heap() -> None:
    """Let all threads of this process share a heap, unless the environment says otherwise. On glibc alone.

    Called before threads are begun. The programs do so; `import wayloom` does not.
    """
    library = None if VARIABLE in os.environ else _glibc()
    if library is not None:
        library.mallopt(M_ARENA_MAX, 1)


def give_back() -> None:
    """Give the system back what has been freed, which glibc keeps where something behind it is still used. Some milliseconds."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(ctypes.c_size_t(0))


def _glibc() -> ctypes.CDLL | None:
    """This process's C library, where it is glibc."""
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    return library if hasattr(library, "gnu_get_libc_version") else None
