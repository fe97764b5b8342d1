"""Compile options of the odometry's kernels: cached, without the GIL, strict IEEE arithmetic, division by zero gives inf or NaN.

`bare` kernels allocate nothing (scratch space is an argument) and count no references, which their callers hold: each array taken
out of a named tuple or sliced would otherwise cost an atomic step, in the innermost loops more than the arithmetic. `inlined` ones
also become part of their callers: passing a dozen arrays costs as much again.

No kernel returns a named tuple to Python: numba makes one by running Python, and crashes where a Ctrl-C is answered there.
"""

from typing import Any, Final

from numba import njit

OPTIONS: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "nogil": True}
BARE: Final[dict[str, Any]] = {**OPTIONS, "_nrt": False}
jit = njit(**OPTIONS)
bare = njit(**BARE)
inlined = njit(**BARE, forceinline=True)
