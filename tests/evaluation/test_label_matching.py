"""Which points are judged: each filter rejects what it is for, and counts it."""

import numpy as np
import pytest

from wayloom.evaluation.label_matching import REASONS, MatchSettings, boundary, match_points, visible_lidar
from wayloom.evaluation.label_truth import TrueFrame
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

CAMERA = PinholeCamera(100.0, 100.0, 59.5, 39.5, 120, 80)
ROAD, BUILDING, SKY, VOID = 0, 2, 10, 255


class HeldTruth:
    """Truth in memory, by frame."""

    def __init__(self, frames: dict[int, TrueFrame]) -> None:
        self.frames = frames

    def frame(self, index: int, /) -> TrueFrame | None:
        return self.frames.get(index)


def odometry(uv: list[tuple[float, float]], depth: list[float], host: list[int]) -> OdometryResult:
    count = len(uv)
    still = np.tile(np.eye(4), (2, 1, 1))
    return OdometryResult(
        StereoRig(CAMERA, (-0.5, 0.0, 0.0)),
        Trajectory(np.arange(2), still, np.ones(2, bool), np.zeros(2, np.int32)),
        Keyframes(np.arange(2, dtype=np.int32), still, np.zeros((2, 4)), np.zeros(2, np.int32)),
        Points(
            np.array(host, np.int32), np.array(uv, np.float32), (1 / np.array(depth)).astype(np.float32),
            np.full(count, 1e-4, np.float32), np.zeros(count, np.uint8), np.zeros(count + 1, np.int64), np.zeros(0, np.int32),
            np.zeros(0, bool), np.zeros(count, bool),
        ),
        0.0,
        np.zeros(3),
    )  # fmt: skip


def wall(depth_m: float, label: int, columns: slice = slice(0, 120), step: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """LiDAR points of a wall across the view, a point every `step` pixels, and their labels."""
    v, u = np.mgrid[0:80:step, 0:120:step]
    there = (u >= columns.start) & (u < columns.stop)
    uv = np.column_stack([u[there], v[there]]).astype(np.float64)
    return CAMERA.rays(uv) * depth_m, np.full(len(uv), label, np.uint8)


def street() -> TrueFrame:
    """From the left: a building, a road that the LiDAR calls terrain, void, sky; without LiDAR in the last columns."""
    image = np.full((80, 120), BUILDING, np.uint8)
    image[:, 40:60], image[:, 60:80], image[:, 80:100] = ROAD, VOID, SKY
    parts = [
        wall(10, BUILDING, slice(0, 40)), wall(10, 9, slice(40, 60)), wall(10, VOID, slice(60, 80)), wall(10, SKY, slice(80, 100))
    ]  # fmt: skip
    return TrueFrame(np.concatenate([p for p, _ in parts]), np.concatenate([c for _, c in parts]), image)


def test_each_filter_rejects_what_it_is_for_and_counts_it() -> None:
    cases = {
        "kept": ((20.3, 40.0), 10.2, 0),
        "image without labels": ((20.0, 40.0), 10.0, 1),
        "no LiDAR point near": ((110.0, 40.0), 10.0, 0),
        "depths disagree": ((20.0, 40.0), 12.0, 0),
        "LiDAR and image disagree": ((50.0, 40.0), 10.0, 0),
        "void": ((70.0, 40.0), 10.0, 0),
        "sky": ((90.0, 40.0), 10.0, 0),
        "boundary": ((38.0, 40.0), 10.0, 0),
    }
    assert tuple(cases) == REASONS
    drive = odometry(*(list(column) for column in zip(*cases.values(), strict=True)))
    matches = match_points(drive, HeldTruth({0: street()}))
    assert [REASONS[code] for code in matches.reason] == list(cases)
    assert matches.filters == dict.fromkeys(REASONS, 1)
    assert matches.truth.tolist() == [BUILDING, *[VOID] * 6, BUILDING]
    assert matches.judged.sum() == 1
    assert matches.judged_with_boundaries.sum() == 2


@pytest.mark.parametrize(("away", "found"), [(1.5, True), (2.5, True), (3.5, False)])
def test_a_point_is_matched_within_the_radius_alone(away: float, found: bool) -> None:
    points, labels = wall(10, BUILDING, slice(0, 41))
    known = TrueFrame(points, labels, np.full((80, 120), BUILDING, np.uint8))
    matches = match_points(odometry([(40.0 + away, 40.0)], [10.0], [0]), HeldTruth({0: known}))
    assert matches.judged.tolist() == [found]


def test_lidar_points_behind_others_beyond_the_range_or_outside_are_not_seen() -> None:
    near, behind, far = wall(10, BUILDING, slice(0, 60)), wall(14, ROAD), wall(120, ROAD)
    outside = np.array([[50.0, 0.0, 10.0], [0.0, 0.0, -5.0]]), np.zeros(2, np.uint8)
    parts = [near, behind, far, outside]
    known = TrueFrame(np.concatenate([p for p, _ in parts]), np.concatenate([c for _, c in parts]), np.zeros((80, 120), np.uint8))
    uv, z, labels = visible_lidar(odometry([(0.0, 0.0)], [1.0], [0]), known, MatchSettings())
    assert set(np.unique(np.round(z, 6))) == {10.0, 14.0}
    assert (uv[labels == ROAD][:, 0] >= 60).all()
    assert (labels == BUILDING).sum() == 60 * 80


def test_a_frame_without_points_or_truth_judges_nothing() -> None:
    matches = match_points(odometry([(20.0, 40.0)], [10.0], [0]), HeldTruth({}))
    assert matches.filters["image without labels"] == 1
    assert not matches.judged.any()


def test_a_boundary_is_where_another_label_lies_within_the_square() -> None:
    image = np.zeros((20, 20), np.uint8)
    image[10, 10] = 7
    edge = boundary(image, 3)
    assert edge[7:14, 7:14].all()
    assert edge.sum() == 49
