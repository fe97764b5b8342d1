"""Compile options of the rendering kernels.

They hold the arrays of a scene in named tuples. Numba would count references each time an array is taken out of one: an atomic step
for every pixel and array, shared by all threads, which costs more than the rendering itself. So counting is switched off: these
kernels allocate nothing (scratch space is an argument), and their callers keep the arrays alive.
"""

from typing import Any, Final

KERNEL: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "nogil": True, "_nrt": False}
INLINE: Final[dict[str, Any]] = {**KERNEL, "inline": "always"}
