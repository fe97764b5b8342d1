"""Real recordings: accuracy that must not worsen, and damage in the middle of a street."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from committed_odometry import least
from wayloom.files.trajectory_files import read_kitti
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog, StereoFrame
from wayloom.odometry.odometry import track
from wayloom.odometry.types import OdometryResult

pytestmark = pytest.mark.real_data


class Damaged:
    """A log cut to frames start to stop, with some of them black."""

    def __init__(self, log: DriveLog, start: int, stop: int, black: tuple[int, ...] = ()) -> None:
        self.log, self.start, self.stop, self.black = log, start, stop, black
        self.t_ns = log.t_ns[start:stop]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.log, name)

    def __len__(self) -> int:
        return self.stop - self.start

    def frame(self, index: int) -> StereoFrame:
        frame = self.log.frame(self.start + index)
        images = (np.zeros_like(frame.left), np.zeros_like(frame.right)) if index in self.black else (frame.left, frame.right)
        return StereoFrame(index, frame.t_ns, *images)


def ate(estimate: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square distance in m of positions (N, 3) after the best rigid motion, no scale."""
    p, q = estimate - estimate.mean(axis=0), truth - truth.mean(axis=0)
    U, _, Vt = np.linalg.svd(p.T @ q)
    R = Vt.T @ np.diag([1, 1, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return float(np.sqrt(((p @ R.T - q) ** 2).sum(axis=1).mean()))


def way(result: OdometryResult) -> float:
    return float(np.linalg.norm(np.diff(result.trajectory.T_world_cam[:, :3, 3], axis=0), axis=1).sum())


def test_clip_a_is_tracked_whole_within_30_cm(tracked_clip_a: OdometryResult, data_dir: Path) -> None:
    result = tracked_clip_a
    truth = read_kitti(data_dir / "kitti_odometry" / "poses" / "00.txt")[:201]
    assert result.trajectory.tracked.all()
    assert len(result.trajectory) == 201
    assert ate(result.trajectory.T_world_cam[:, :3, 3], truth[:, :3, 3]) < 0.26
    assert ate(result.trajectory.T_world_cam[16:, :3, 3], truth[16:, :3, 3]) < 0.20
    assert len(result.points) >= least("A", "points/m") * way(result)


def test_clip_b_is_tracked_whole_and_its_length_is_right(tracked_clip_b: OdometryResult) -> None:
    result = tracked_clip_b
    assert result.trajectory.tracked.all()
    assert way(result) == pytest.approx(71.3, rel=0.025)
    assert -0.9 < result.disparity_bias_px < -0.2  # LiDAR says -0.45 to -0.6


def test_black_frames_in_a_real_street_are_bridged(clip_a: Path, data_dir: Path) -> None:
    log = Damaged(open_log(clip_a), 20, 60, black=(0, 14, 15, 16, 39))
    result = track(log)
    assert np.flatnonzero(~result.trajectory.tracked).tolist() == [0, 14, 15, 16, 39]
    assert len(result.report["segments"]) == 1
    truth = read_kitti(data_dir / "kitti_odometry" / "poses" / "00.txt")[20:60]
    seen = result.trajectory.tracked
    assert ate(result.trajectory.T_world_cam[seen, :3, 3], truth[seen, :3, 3]) < 0.2


def test_a_real_street_gives_the_same_bits_with_any_number_of_threads(clip_a: Path) -> None:
    log = Damaged(open_log(clip_a), 0, 24)
    one, two = track(log), track(log, threads=2)
    np.testing.assert_array_equal(one.trajectory.T_world_cam, two.trajectory.T_world_cam)
    np.testing.assert_array_equal(one.points.inverse_depth, two.points.inverse_depth)
    np.testing.assert_array_equal(one.points.obs_keyframe, two.points.obs_keyframe)
