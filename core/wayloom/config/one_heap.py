"""Heaps that threads take their memory from.

glibc gives threads heaps of their own, and what was freed in one is used by no other: a drive on two threads kept 0.1 GB between
its stages and peaked 0.2 GB higher for it. Kernels allocate nothing, so threads hardly wait for one heap.
"""

import ctypes
import os
import sys
from typing import Final

VARIABLE: Final = "MALLOC_ARENA_MAX"
M_ARENA_MAX: Final = -8
"""Of glibc's malloc.h."""


def use_one_heap() -> bool:
    """Let all threads of this process share a heap, unless the environment says otherwise; whether they do. Nothing but on glibc.

    Called before threads are begun. The programs do so; `import wayloom` does not.
    """
    if sys.platform != "linux" or VARIABLE in os.environ:
        return False
    library = ctypes.CDLL(None)
    return hasattr(library, "gnu_get_libc_version") and library.mallopt(M_ARENA_MAX, 1) == 1
