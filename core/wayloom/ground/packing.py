"""Packing of rasters: differences along the rows, modulo the type's range, which pack to less than the values."""

import zlib
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import DTypeLike, NDArray


def packed(raster: NDArray[Any], dtype: DTypeLike, level: int) -> bytes:
    """One zlib stream, at a level, of a raster (H, W, ...): of each value less the one to its west."""
    values = raster.astype(dtype)
    return zlib.compress(np.concatenate([values[:, :1], values[:, 1:] - values[:, :-1]], axis=1).tobytes(), level)


def unpacked(data: bytes | memoryview, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """The inverse of `packed`. Raises ValueError for bytes that are none."""
    try:
        differences = isal_zlib.decompress(data)
    except isal_zlib.error as problem:  # type: ignore[misc]  # a class, which the stub takes for an instance
        raise ValueError(problem) from problem
    return np.cumsum(np.frombuffer(differences, dtype).reshape(shape), axis=1, dtype=dtype)
