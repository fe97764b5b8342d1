"""Heights above a geoid, by a made grid whose geoid is a plane in longitude and latitude."""

import struct
from pathlib import Path

import numpy as np
import pytest

from wayloom.errors import InputError
from wayloom.geodesy.geoid import GeoidGrid


def undulation(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """m: bilinear, so that a bilinear interpolation of the grid is exact but for its 4-byte floats."""
    return np.asarray(47.0 + 0.8 * (lon - 8.0) - 0.6 * (lat - 49.0))


def write_gtx(file: Path, south: float = 48.0, west: float = 7.0, step: float = 0.25, count: int = 13) -> Path:
    """NOAA's GTX: south, west, steps (big-endian doubles), rows, columns (int32), heights from the south (float32)."""
    lat, lon = np.meshgrid(south + step * np.arange(count), west + step * np.arange(count), indexing="ij")
    head = struct.pack(">4d2i", south, west, step, step, count, count)
    file.write_bytes(head + undulation(lon, lat).astype(">f4").tobytes())
    return file


def test_the_height_above_the_geoid_is_the_ellipsoidal_one_less_the_undulation(tmp_path: Path) -> None:
    grid = GeoidGrid(write_gtx(tmp_path / "a grid with a name.gtx"))
    places = np.random.default_rng(0).uniform([7.1, 48.1, -100.0], [9.9, 50.9, 900.0], (200, 3))
    expected = places[:, 2] - undulation(places[:, 0], places[:, 1])
    np.testing.assert_allclose(grid.orthometric(places), expected, rtol=0.0, atol=2.0**-18)  # a float32 of 47


def test_a_missing_grid_a_wrong_file_and_a_place_beyond_it_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such geoid grid"):
        GeoidGrid(tmp_path / "none.gtx")
    (tmp_path / "text.gtx").write_text("no grid at all")
    with pytest.raises(InputError, match="is no geoid grid"):
        GeoidGrid(tmp_path / "text.gtx")
    with pytest.raises(InputError, match="rename the file"):
        GeoidGrid(write_gtx(tmp_path / "a,b.gtx"))
    grid = GeoidGrid(write_gtx(tmp_path / "grid.gtx"))
    with pytest.raises(InputError, match=r"does not cover longitude 20\.00000"):
        grid.orthometric(np.array([[8.0, 49.0, 100.0], [20.0, 49.0, 100.0]]))
