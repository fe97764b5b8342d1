"""The file of loop closures."""

from pathlib import Path

import numpy as np
import pytest

from wayloom.errors import StageError
from wayloom.loops.files import load_loops, save_loops
from wayloom.loops.types import LoopClosures, no_loops


def some_loops() -> LoopClosures:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, 3] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    return LoopClosures(
        np.array([3, 5], np.int32), np.array([90, 95], np.int32), T, np.tile(0.01 * np.eye(6), (2, 1, 1)), {"pairs": 2}
    )


def test_closures_come_back_as_they_were(tmp_path: Path) -> None:
    loops = some_loops()
    save_loops(loops, tmp_path / "loops.npz")
    back = load_loops(tmp_path / "loops.npz")
    for name in ("first", "second", "T_first_second", "covariance"):
        np.testing.assert_array_equal(getattr(back, name), getattr(loops, name))
    assert back.report == {"pairs": 2}


def test_a_drive_without_closures_has_a_file_too(tmp_path: Path) -> None:
    save_loops(no_loops(), tmp_path / "loops.npz")
    assert len(load_loops(tmp_path / "loops.npz")) == 0


def test_equal_closures_give_equal_bytes(tmp_path: Path) -> None:
    save_loops(some_loops(), tmp_path / "a.npz")
    save_loops(some_loops(), tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize("kept", [0, 100, -30])
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, kept: int) -> None:
    file = tmp_path / "loops.npz"
    save_loops(some_loops(), file)
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(StageError, match=r"loops\.npz.*again"):
        load_loops(file)
