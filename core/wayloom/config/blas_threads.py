"""Threads that the linear algebra library takes.

Its threads wait for one another by spinning. The matrices of a window are small, so they gain nothing by them, and where several
processes share the cores, each spins away what another one could use.
"""

import os
from typing import Final

VARIABLE: Final = "OPENBLAS_NUM_THREADS"


def use_one_blas_thread() -> None:
    """Let OpenBLAS take one thread in this process and its children, unless the environment says otherwise.

    Called before numpy is imported. The programs do so; `import wayloom` does not: a notebook's own algebra is not ours to slow.
    """
    os.environ.setdefault(VARIABLE, "1")
