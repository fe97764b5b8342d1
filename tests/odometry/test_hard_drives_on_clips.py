"""What breaks direct methods, put into real recordings: few frames a second, buses, glare, damaged files."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_street import TEXTURES

from wayloom.evaluation.odometry_recordings import Thinned
from wayloom.evaluation.trajectory import ate_rmse
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog, StereoFrame
from wayloom.odometry.odometry import track
from wayloom.odometry.types import OdometryResult

pytestmark = pytest.mark.real_data
Change = Callable[[int, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class Changed(Thinned):
    """Frames of a log, their images changed."""

    def __init__(self, log: DriveLog, kept: np.ndarray, change: Change) -> None:
        super().__init__(log, kept)
        self.change = change

    def frame(self, index: int) -> StereoFrame:
        frame = super().frame(index)
        return StereoFrame(index, frame.t_ns, *self.change(index, frame.left, frame.right))


def same(index: int, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return left, right


def run(clip: Path, kept: np.ndarray, change: Change = same) -> tuple[OdometryResult, float]:
    """The result, and its ATE in m where the clip has poses of its own."""
    log = Changed(open_log(clip), kept, change)
    result = track(log)
    return result, float("nan") if log.truth is None else ate_rmse(result.trajectory.T_world_cam, log.truth)


@pytest.mark.parametrize(("step", "limit_m"), [(3, 0.15), (6, 0.2)])
def test_a_turn_at_a_third_and_a_sixth_of_the_frames_is_followed(clip_a: Path, step: int, limit_m: float) -> None:
    result, error = run(clip_a, np.arange(100, 201, step))  # a sixth: 5 m and up to 20 degrees between frames
    assert result.trajectory.tracked.all()
    assert len(result.report["segments"]) == 1
    assert error < limit_m
    again = track(Thinned(open_log(clip_a), np.arange(100, 201, step)), threads=2)
    np.testing.assert_array_equal(again.trajectory.T_world_cam, result.trajectory.T_world_cam)


def test_a_bus_over_half_of_the_image_is_not_taken_for_the_world(clip_a: Path) -> None:
    def bus(index: int, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        images = left.copy(), right.copy()
        for image, disparity in zip(images, (0, 30), strict=True):
            start = left.shape[1] - 30 * (index - 8) - disparity
            a, b = max(0, start), max(0, min(left.shape[1], start + left.shape[1] // 2))
            if a < b:
                image[40:, a:b] = np.tile(TEXTURES[0], (1, 2))[: len(left) - 40, a - start : b - start].astype(np.uint8)
        return images

    result, error = run(clip_a, np.arange(30, 80), bus)
    assert result.trajectory.tracked.all()
    assert error < 0.2


def test_a_low_sun_that_wanders_through_the_image_costs_no_frame(clip_a: Path) -> None:
    def glare(index: int, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v, u = np.mgrid[: left.shape[0], : left.shape[1]]
        strength = np.clip(75.0 * (index - 9), 0, 300)
        light = [strength * np.exp(-((u - 500 - 8 * index + d) ** 2 + (v - 60) ** 2) / (2 * 180.0**2)) for d in (0, 5)]
        return tuple(np.clip(i + x, 0, 255).astype(np.uint8) for i, x in zip((left, right), light, strict=True))  # type: ignore[return-value]

    result, error = run(clip_a, np.arange(30, 70), glare)
    assert result.trajectory.tracked.all()
    assert error < 0.3


def test_a_jpeg_damaged_inside_is_bridged(clip_b: Path) -> None:
    def damaged(index: int, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if index != 12:
            return left, right
        data = bytearray(cv2.imencode(".jpg", left[..., ::-1])[1].tobytes())
        middle = len(data) // 3
        data[middle : middle + 600] = bytes(np.random.default_rng(0).integers(0, 255, 600).astype(np.uint8))
        broken = cv2.imdecode(np.frombuffer(bytes(data), np.uint8), cv2.IMREAD_COLOR)
        assert np.abs(broken[..., ::-1].astype(int) - left).mean() > 10
        return np.ascontiguousarray(broken[..., ::-1]), right

    result, _ = run(clip_b, np.arange(20, 44), damaged)
    whole, _ = run(clip_b, np.arange(20, 44))
    assert len(result.report["segments"]) == 1
    others = np.arange(24) != 12
    assert result.trajectory.tracked[others].all()
    difference = result.trajectory.T_world_cam[others, :3, 3] - whole.trajectory.T_world_cam[others, :3, 3]
    assert np.linalg.norm(difference, axis=1).max() < 0.15
