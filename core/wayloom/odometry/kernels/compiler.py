"""Compile options of the odometry's kernels: cached, without the GIL, strict IEEE arithmetic, division by zero gives inf or NaN.

Kernels allocate nothing (working space is an argument) and count no references, which their callers hold: each array taken out of a
named tuple or sliced would otherwise cost an atomic step, in the innermost loops more than the arithmetic, and much of the time
that a kernel takes to compile. Plain functions of Python beside them make the arrays.

A `kernel` is called from Python. A `part` is called by kernels only: it has no door for Python, and is stored with its callers.
An `inlined` part becomes part of its callers: passing a dozen arrays costs as much again. A caller's code holds that of all its
parts, which is optimised once more for each of them: the loop around kernels is Python wherever a pass takes longer than a call.

No kernel returns a named tuple to Python: numba makes one by running Python, and crashes where a Ctrl-C is answered there.
"""

from collections.abc import Callable
from typing import Any, Final

from numba import njit

OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "nogil": True, "_nrt": False, "no_cfunc_wrapper": True}
PART: Final[dict[str, Any]] = {**OPTIONS, "no_cpython_wrapper": True}
kernel = njit(**OPTIONS, cache=True)
part = njit(**PART)
inlined = njit(**PART, forceinline=True)


def opened(inner: Callable[..., Any]) -> Callable[..., Any]:
    """A part with a door for Python: for tests and benchmarks."""
    return njit(**OPTIONS)(getattr(inner, "py_func", inner))
