"""How every kernel is compiled: cached on disk, without the GIL, strict IEEE arithmetic, division by zero gives inf or NaN."""

from numba import njit

jit = njit(cache=True, error_model="numpy", nogil=True)
