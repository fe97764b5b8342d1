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
    if sys.platform != "linux" or VARIABLE in os.environ:
        return
    library = ctypes.CDLL(None)
    if hasattr(library, "gnu_get_libc_version"):
        library.mallopt(M_ARENA_MAX, 1)
