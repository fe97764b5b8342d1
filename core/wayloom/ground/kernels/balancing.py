"""Medians over tiles around."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def medians(values, there, reach, stride, out, found):  # type: ignore[no-untyped-def]
    """The lower median of values (K, N, N) int64 over the squares up to `reach` away, every `stride`-th of them, that are there
    (N, N) bool: out (K, N, N), and found (N, N) bool where any is, in place."""
    count, rows, columns = values.shape
    held = np.zeros((2 * reach // stride + 1) ** 2, np.int64)
    for i in range(rows):
        for j in range(columns):
            for k in range(count):
                n = 0
                for r in range(i - reach, i + reach + 1, stride):
                    for c in range(j - reach, j + reach + 1, stride):
                        if 0 <= r < rows and 0 <= c < columns and there[r, c]:
                            held[n] = values[k, r, c]
                            n += 1
                if n > 0:
                    out[k, i, j] = np.sort(held[:n])[(n - 1) // 2]
                    found[i, j] = True
