"""Trajectory files, as evo reads them."""

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from logs.made_drives import START_NS, made_poses
from wayloom.errors import LogError
from wayloom.files.trajectory_files import read_kitti, read_tum, write_kitti, write_tum
from wayloom.geometry import se3


def trajectory() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    T = made_poses(40) @ se3.exp(rng.normal(size=(40, 6)) * [1, 1, 1, 2, 2, 2])
    return START_NS + np.arange(40) * 100_000_003, T


def test_evo_reads_our_tum_file(tmp_path: Path) -> None:
    t_ns, T = trajectory()
    write_tum(tmp_path / "traj.tum", t_ns, T)
    evo = file_interface.read_tum_trajectory_file(tmp_path / "traj.tum")
    np.testing.assert_allclose(evo.timestamps, t_ns / 1e9, atol=1e-6)
    np.testing.assert_allclose(np.array(evo.poses_se3), T, atol=1e-7)


def test_guessed_poses_stand_between_comments_that_evo_and_we_pass_over(tmp_path: Path) -> None:
    t_ns, T = trajectory()
    tracked = np.ones(40, bool)
    tracked[:2] = tracked[10:14] = tracked[39:] = False
    write_tum(tmp_path / "traj.tum", t_ns, T, tracked)
    lines = (tmp_path / "traj.tum").read_text().splitlines()
    guessed, kind = [], "tracked"
    for line in lines:
        if line.startswith("#"):
            kind = line.removeprefix("# ").partition(":")[0]
        else:
            guessed.append(kind == "guessed")
    assert guessed == (~tracked).tolist()
    evo = file_interface.read_tum_trajectory_file(tmp_path / "traj.tum")
    np.testing.assert_allclose(np.array(evo.poses_se3), T, atol=1e-7)
    np.testing.assert_array_equal(read_tum(tmp_path / "traj.tum")[0], t_ns)


def test_a_drive_that_was_tracked_throughout_has_a_file_without_comments(tmp_path: Path) -> None:
    t_ns, T = trajectory()
    write_tum(tmp_path / "plain.tum", t_ns, T)
    write_tum(tmp_path / "tracked.tum", t_ns, T, np.ones(40, bool))
    assert (tmp_path / "tracked.tum").read_bytes() == (tmp_path / "plain.tum").read_bytes()


def test_evo_reads_our_kitti_file_as_poses_relative_to_the_first(tmp_path: Path) -> None:
    _, T = trajectory()
    write_kitti(tmp_path / "traj.kitti", T)
    evo = file_interface.read_kitti_poses_file(tmp_path / "traj.kitti")
    np.testing.assert_allclose(np.array(evo.poses_se3), se3.inverse(T[0]) @ T, atol=1e-7)


def test_tum_comes_back_with_exact_time_stamps(tmp_path: Path) -> None:
    t_ns, T = trajectory()
    write_tum(tmp_path / "new" / "traj.tum", t_ns, T)
    t_again, T_again = read_tum(tmp_path / "new" / "traj.tum")
    np.testing.assert_array_equal(t_again, t_ns)
    np.testing.assert_allclose(T_again, T, atol=1e-8)


def test_kitti_comes_back(tmp_path: Path) -> None:
    _, T = trajectory()
    write_kitti(tmp_path / "traj.kitti", T)
    np.testing.assert_allclose(read_kitti(tmp_path / "traj.kitti"), se3.inverse(T[0]) @ T, atol=1e-8)


def test_a_trajectory_of_nothing_is_an_empty_file(tmp_path: Path) -> None:
    write_kitti(tmp_path / "a", np.zeros((0, 4, 4)))
    write_tum(tmp_path / "b", np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    assert read_kitti(tmp_path / "a").shape == read_tum(tmp_path / "b")[1].shape == (0, 4, 4)


def test_comments_and_blank_lines_of_tum_files_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "t").write_text("# time x y z\n\n1.5 1 2 3 0 0 0 1\n")
    t_ns, T = read_tum(tmp_path / "t")
    assert t_ns.tolist() == [1_500_000_000]
    assert T[0, :3, 3].tolist() == [1, 2, 3]


@pytest.mark.parametrize("line", ["1 2 3", "x 1 2 3 0 0 0 1", "1 1 2 3 0 0 0 nan", "1 1 2 3 0 0 0 5"])
def test_a_spoilt_line_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "t").write_text("0.5 1 2 3 0 0 0 1\n" + line + "\n")
    with pytest.raises(LogError, match="line 2"):
        read_tum(tmp_path / "t")


@pytest.mark.real_data
def test_the_truth_of_clip_a_is_that_of_evo(data_dir: Path) -> None:
    file = data_dir / "kitti_odometry" / "poses" / "00.txt"
    np.testing.assert_allclose(read_kitti(file), np.array(file_interface.read_kitti_poses_file(file).poses_se3), atol=1e-12)
