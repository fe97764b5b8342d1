"""Point clouds in PLY."""

import time
from pathlib import Path

import numpy as np
import pytest

from wayloom.errors import LogError
from wayloom.files.ply import read_ply, write_ply


def cloud(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (count, 3)) + np.array([61_234.5, -48_000.25, 115.0])
    return points, rng.integers(0, 256, (count, 3), dtype=np.uint8), rng.integers(0, 20, count, dtype=np.uint8)


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_a_cloud_comes_back_exactly(tmp_path: Path, count: int) -> None:
    points, colours, labels = cloud(count)
    write_ply(tmp_path / "cloud.ply", points, colours, labels, comments=("frame enu", "two\nlines"))
    got = read_ply(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(got.points, points)
    np.testing.assert_array_equal(got.colours, colours)
    np.testing.assert_array_equal(got.labels, labels)


def test_the_header_says_what_follows(tmp_path: Path) -> None:
    write_ply(tmp_path / "cloud.ply", *cloud(7), comments=("frame world",))
    data = (tmp_path / "cloud.ply").read_bytes()
    header = data[: data.index(b"end_header\n")].decode().splitlines()
    assert header[:4] == ["ply", "format binary_little_endian 1.0", "comment frame world", "element vertex 7"]
    fields = [f"property double {name}" for name in "xyz"] + [
        f"property uchar {name}" for name in ("red", "green", "blue", "label")
    ]
    assert header[4:] == fields
    assert len(data) == data.index(b"end_header\n") + 11 + 7 * 28


def test_two_million_points_take_a_moment(tmp_path: Path) -> None:
    parts = cloud(2_000_000)
    start = time.process_time()
    write_ply(tmp_path / "cloud.ply", *parts)
    read_ply(tmp_path / "cloud.ply")
    assert time.process_time() - start < 5.0


def test_a_cloud_of_floats_without_labels_is_read_too(tmp_path: Path) -> None:
    fields = "".join(f"property float {name}\n" for name in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 2\n{fields}end_header\n"
    (tmp_path / "c.ply").write_bytes(header.encode() + np.arange(6, dtype="<f4").tobytes())
    got = read_ply(tmp_path / "c.ply")
    assert got.points.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert got.labels.tolist() == [255, 255]


@pytest.mark.parametrize("spoilt", [b"", b"ply\n", b"ply\nformat ascii 1.0\nend_header\n"])
def test_what_is_no_binary_ply_is_refused(tmp_path: Path, spoilt: bytes) -> None:
    (tmp_path / "c.ply").write_bytes(spoilt)
    with pytest.raises(LogError, match="is no binary little-endian PLY"):
        read_ply(tmp_path / "c.ply")


def test_a_truncated_cloud_says_how_much_is_there(tmp_path: Path) -> None:
    write_ply(tmp_path / "c.ply", *cloud(10))
    data = (tmp_path / "c.ply").read_bytes()
    (tmp_path / "c.ply").write_bytes(data[:-30])
    with pytest.raises(LogError, match="ends after 8 of 10 points"):
        read_ply(tmp_path / "c.ply")


@pytest.mark.parametrize(
    ("old", "new"), [(b"double x", b"list y x"), (b"vertex 3", b"vertex x"), (b"double x", b"double w"), (b"double y", b"double x")]
)
def test_a_strange_header_is_refused(tmp_path: Path, old: bytes, new: bytes) -> None:
    write_ply(tmp_path / "c.ply", *cloud(3))
    (tmp_path / "c.ply").write_bytes((tmp_path / "c.ply").read_bytes().replace(old, new))
    with pytest.raises(LogError):
        read_ply(tmp_path / "c.ply")
