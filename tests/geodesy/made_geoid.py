"""A made geoid grid: a plane in longitude and latitude, 7 to 10 degrees east, 48 to 51 degrees north."""

import struct
from pathlib import Path

import numpy as np


def undulation(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """m: bilinear, so that a bilinear interpolation of the grid is exact but for its 4-byte floats."""
    return np.asarray(47.0 + 0.8 * (lon - 8.0) - 0.6 * (lat - 49.0))


def write_gtx(file: Path, south: float = 48.0, west: float = 7.0, step: float = 0.25, count: int = 13) -> Path:
    """NOAA's GTX: south, west, steps (big-endian doubles), rows, columns (int32), heights from the south (float32)."""
    lat, lon = np.meshgrid(south + step * np.arange(count), west + step * np.arange(count), indexing="ij")
    head = struct.pack(">4d2i", south, west, step, step, count, count)
    file.write_bytes(head + undulation(lon, lat).astype(">f4").tobytes())
    return file
