"""Packing of rasters: differences along the rows, modulo the type's range, which pack to less than the values."""

import zlib
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


def packed(raster: NDArray[Any], dtype: DTypeLike, level: int) -> bytes:
    """One zlib stream, at a level, of a raster (H, W, ...): of each value less the one to its west."""
    values = raster.astype(dtype)
    return zlib.compress(np.concatenate([values[:, :1], values[:, 1:] - values[:, :-1]], axis=1).tobytes(), level)


def unpacked(data: bytes | memoryview, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """The inverse of `packed`. Raises ValueError or zlib.error for bytes that are none."""
    return np.cumsum(np.frombuffer(zlib.decompress(data), dtype).reshape(shape), axis=1, dtype=dtype)
