"""Static stereo against the window's motion: a window that follows what moves is found out, and its steps are doubted."""

import made_street
import numpy as np
import pytest
from made_street import MadeLog, curve
from made_window import NUMBERS, ROBUST, made_window
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.backend.stereo_scale import LEAST_VOTES, SCALES, SpanScale, StereoScale, strongest_vote
from wayloom.odometry.backend.window import Window, chosen
from wayloom.odometry.odometry import track
from wayloom.odometry.result.result_builder import KeyframeRow, ResultBuilder
from wayloom.odometry.types import OdometryResult


def scale_of(window: Window, points: Window) -> SpanScale | None:
    """By the points of `points`, each keyframe's own."""
    scale = StereoScale()
    for f, row in enumerate(points.keyframe.tolist()):
        scale.add(row, chosen(points.points, points.points.host == f))
    return scale.measure(window, NUMBERS, ROBUST)


def with_way(window: Window, share: float) -> Window:
    """Every keyframe at that share of its way from the first one."""
    T_world_cam = se3.inverse(window.frames.T_cam_world)
    T_world_cam[:, :3, 3] = T_world_cam[0, :3, 3] + share * (T_world_cam[:, :3, 3] - T_world_cam[0, :3, 3])
    window.frames = window.frames._replace(T_cam_world=se3.inverse(T_world_cam))
    return window


@pytest.mark.parametrize("share", [1.0, 0.8, 0.92, 1.15])
def test_the_street_tells_the_true_way_over_that_of_the_window(share: float) -> None:
    span = scale_of(with_way(made_window(6, 60, disturbed=False), share), made_window(6, 60, disturbed=False))
    assert span is not None
    assert (span.first, span.last) == (0, 5)
    assert span.way_m == pytest.approx(share * 5 * 0.8, rel=0.01)
    assert span.log_scale == pytest.approx(-np.log(share), abs=0.01)
    assert span.sigma < 0.01
    assert span.is_off() == (share != 1.0)


def test_all_points_are_asked_only_where_a_third_of_them_find_something_amiss() -> None:
    points = made_window(6, 60, disturbed=False)
    right, wrong = (scale_of(with_way(made_window(6, 60, disturbed=False), share), points) for share in (1.0, 0.92))
    assert right is not None
    assert wrong is not None
    assert 2.5 * right.votes < wrong.votes


def test_a_span_of_less_than_two_metres_tells_nothing() -> None:
    window = made_window(6, 60, disturbed=False)
    assert scale_of(with_way(window, 0.4), window) is None


def test_a_few_points_tell_nothing() -> None:
    window = made_window(6, 60, disturbed=False)
    few = made_window(6, 60, disturbed=False)
    few.points = chosen(few.points, np.arange(0, len(few.points.rho), 40))
    assert len(few.points.rho) < LEAST_VOTES
    assert scale_of(window, few) is None


def test_the_most_votes_win_however_sure_the_others_are() -> None:
    rng = np.random.default_rng(0)
    street, wrong = rng.normal(0.2, 0.05, 40), np.full(15, -0.3)
    scale, sigma = strongest_vote(np.concatenate([street, wrong]), np.repeat([0.05, 0.001], [40, 15]))
    assert scale == pytest.approx(0.2, abs=3 * sigma)
    assert sigma == pytest.approx(0.05 / np.sqrt(40), rel=0.4)


def test_votes_that_scatter_by_more_than_they_say_are_as_unsure_as_they_scatter() -> None:
    votes = np.random.default_rng(1).normal(0.0, 0.2, 200)
    _, sigma = strongest_vote(votes, np.full(200, 0.05))
    assert sigma > 2.0 * 0.05 / np.sqrt(200)


def test_scales_that_are_searched_include_none_at_all() -> None:
    assert np.abs(SCALES).min() < 1e-12


def test_doubt_widens_a_step_along_its_way_and_no_other() -> None:
    builder, T = ResultBuilder(), np.eye(4)
    for k in range(4):
        builder.keyframes.append(KeyframeRow(k, 0, T, np.zeros(4), np.eye(6) * (np.nan if k == 0 else 1e-4)))
        T = se3.inverse(se3.exp(np.array([0.1, 0.0, 1.0, 0.0, 0.02, 0.0]))) @ T
    builder.doubt_steps(1, 3, 0.5)
    builder.doubt_steps(1, 2, 0.2)
    covariance = builder.final_keyframes().step_covariance.astype(np.float64)
    assert np.isnan(covariance[0]).all()
    np.testing.assert_allclose(covariance[1], 1e-4 * np.eye(6), rtol=1e-6)
    along = se3.exp(np.array([0.1, 0.0, 1.0, 0.0, 0.02, 0.0]))[:3, 3]
    along /= np.linalg.norm(along)
    across = np.cross(along, [0.0, 1.0, 0.0])
    for k in (2, 3):
        assert along @ covariance[k, :3, :3] @ along == pytest.approx(0.5001, rel=1e-4)
        assert across @ covariance[k, :3, :3] @ across == pytest.approx(1e-4, rel=1e-2)
        np.testing.assert_allclose(covariance[k, 3:, 3:], 1e-4 * np.eye(3), rtol=1e-6)


class BetweenBuses(MadeLog):
    """The made street, pale as it is in haze, and a bus of 8 m on either side that drives off a fifth as fast as the car, from
    frame 12 on, when the car comes between them."""

    def drawn(self, index: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        bus = slice(*(np.array([8, 16]) * int(made_street.TEXELS_PER_M) + max(index - 12, 0)))  # a texel a frame
        vivid = list(made_street.TEXTURES)
        planes = [125.0 + share * (plane - 125.0) for share, plane in zip((0.25, 0.4, 0.4, 0.25, 0.25), vivid, strict=True)]
        for side in (1, 2):
            planes[side][bus] = vivid[side][400 : 400 + bus.stop - bus.start]
        made_street.TEXTURES[:] = planes
        try:
            left, right, _ = made_street.pair(self.truth[index], self.rig, self.bias_px)
            return made_street.grey(left), made_street.grey(right)
        finally:
            made_street.TEXTURES[:] = vivid


@pytest.fixture(scope="module")
def misled() -> tuple[BetweenBuses, OdometryResult]:
    log = BetweenBuses(curve(56))
    return log, track(log)


def way(T_world_cam: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1).sum())


def test_steps_between_two_buses_are_as_unsure_as_they_are_wrong(misled) -> None:
    log, result = misled
    keyframes = result.keyframes
    error = way(keyframes.T_world_cam) - way(log.truth[keyframes.frame])
    assert abs(error) > 1.0  # they did mislead it
    sigma = np.sqrt(np.trace(keyframes.step_covariance[1:, :3, :3], axis1=1, axis2=2).sum())
    assert 0.4 * sigma < abs(error) < 2.0 * sigma
    assert 5 < result.report["doubted_steps"] < 20


def test_steps_before_and_long_after_the_buses_are_not_doubted(misled) -> None:
    keyframes = misled[1].keyframes
    sigma = np.sqrt(np.diagonal(keyframes.step_covariance, axis1=1, axis2=2)).max(axis=1)
    long_after = keyframes.frame > 50  # at 36 the last step errs by 4 %, and a span reaches six keyframes back
    assert long_after.sum() >= 2
    assert np.nanmax(sigma[(keyframes.frame < 8) | long_after]) < 0.02


def test_no_step_of_a_still_street_is_doubted() -> None:
    keyframes = track(MadeLog(curve(44))).keyframes
    assert np.sqrt(np.nanmax(np.diagonal(keyframes.step_covariance, axis1=1, axis2=2))) < 0.02
