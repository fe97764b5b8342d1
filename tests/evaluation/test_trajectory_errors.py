"""Trajectory errors agree with evo, with a naive twin, and with what is known by construction."""

import math

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PosePath3D

from wayloom.errors import InputError
from wayloom.evaluation import trajectory
from wayloom.geometry import se3


@pytest.fixture
def drive() -> tuple[np.ndarray, np.ndarray]:
    """(estimate, truth), each (240, 4, 4): a winding road of about 190 m and a noisy estimate of it in another world frame."""
    rng = np.random.default_rng(7)
    twist = np.zeros((239, 6))
    twist[:, 2] = 0.8
    twist[:, 4] = 0.02 * np.sin(np.arange(239) / 25.0)
    twist[:, 3] = 0.003 * np.cos(np.arange(239) / 11.0)
    noise = rng.normal(size=(239, 6)) * [0.01, 0.01, 0.02, 1e-3, 1e-3, 1e-3]
    truth, estimate = [np.eye(4)], [se3.exp(np.array([4.0, -2.0, 9.0, 0.3, -0.8, 0.2]))]
    for step, error in zip(twist, noise, strict=True):
        truth.append(truth[-1] @ se3.exp(step))
        estimate.append(estimate[-1] @ se3.exp(step + error))
    return np.array(estimate), np.array(truth)


def evo_path(T: np.ndarray) -> PosePath3D:
    return PosePath3D(poses_se3=list(T))


def test_ate_is_that_of_evo(drive):
    estimate, truth = drive
    aligned = evo_path(estimate.copy())
    aligned.align(evo_path(truth), correct_scale=False)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((evo_path(truth), aligned))
    assert trajectory.ate_rmse(estimate, truth) == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-6)


@pytest.mark.parametrize(
    ("relation", "field"),
    [
        (metrics.PoseRelation.translation_part, "frame_translation_m"),
        (metrics.PoseRelation.rotation_angle_deg, "frame_rotation_deg"),
    ],
)
def test_the_error_from_frame_to_frame_is_that_of_evo(drive, relation, field):
    estimate, truth = drive
    rpe = metrics.RPE(relation, delta=1, delta_unit=metrics.Unit.frames)
    rpe.process_data((evo_path(truth), evo_path(estimate)))
    assert getattr(trajectory.evaluate(estimate, truth), field) == pytest.approx(
        rpe.get_statistic(metrics.StatisticsType.rmse), abs=1e-6
    )


@pytest.mark.parametrize("relation", [metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg])
def test_the_error_of_stretches_is_that_of_evo_over_the_same_pairs(drive, relation):
    estimate, truth = drive
    rpe = metrics.RPE(relation, delta=30, delta_unit=metrics.Unit.frames, all_pairs=True)
    rpe.process_data((evo_path(truth), evo_path(estimate)))
    pairs = np.column_stack([np.arange(210), np.arange(30, 240)])
    translation, rotation = trajectory.relative_errors(estimate, truth, pairs)
    mine = translation if relation is metrics.PoseRelation.translation_part else np.degrees(rotation)
    np.testing.assert_allclose(mine, rpe.error, atol=1e-6)


def test_path_length_is_that_of_evo(drive):
    estimate, _ = drive
    assert trajectory.path_length(estimate[:, :3, 3]) == pytest.approx(evo_path(estimate).path_length, abs=1e-6)


def naive_kitti_errors(estimate, truth, lengths):
    """KITTI's published procedure, one stretch at a time."""
    travelled = [0.0]
    for i in range(1, len(truth)):
        travelled.append(travelled[-1] + float(np.linalg.norm(truth[i, :3, 3] - truth[i - 1, :3, 3])))
    shares, rates = [], []
    for i in range(len(truth)):
        for length in lengths:
            j = next((k for k in range(i, len(truth)) if travelled[k] >= travelled[i] + length), None)
            if j is None:
                continue
            motion_truth = np.linalg.inv(truth[i]) @ truth[j]
            motion_estimate = np.linalg.inv(estimate[i]) @ estimate[j]
            error = np.linalg.inv(motion_estimate) @ motion_truth
            shares.append(float(np.linalg.norm(error[:3, 3])) / length)
            rates.append(math.acos(min(1.0, (np.trace(error[:3, :3]) - 1.0) / 2.0)) / length)
    return 100 * float(np.mean(shares)), 100 * math.degrees(float(np.mean(rates)))


def test_relative_errors_are_those_of_a_naive_twin(drive):
    estimate, truth = drive
    lengths = (25.0, 50.0, 75.0, 100.0)
    t_rel, r_rel = trajectory.kitti_errors(estimate, truth, lengths)
    naive_t, naive_r = naive_kitti_errors(estimate, truth, lengths)
    assert t_rel == pytest.approx(naive_t, abs=1e-6)
    assert r_rel == pytest.approx(naive_r, abs=1e-5)


def test_the_same_path_in_another_world_frame_has_no_error(drive):
    _, truth = drive
    errors = trajectory.evaluate(se3.exp(np.array([100.0, -7.0, 3.0, 1.0, 0.4, -2.0])) @ truth, truth)
    assert errors.ate_m < 1e-9
    assert errors.t_rel_percent < 1e-9
    assert errors.r_rel_deg_per_100m < 1e-9
    assert errors.length_ratio == pytest.approx(1.0)


def test_a_wrong_scale_is_not_aligned_away(drive):
    _, truth = drive
    longer = truth.copy()
    longer[:, :3, 3] *= 1.02
    errors = trajectory.evaluate(longer, truth)
    assert errors.length_ratio == pytest.approx(1.02)
    assert errors.t_rel_percent == pytest.approx(2.0, rel=0.05)
    assert errors.ate_m > 0.3


def test_a_mirrored_path_is_not_called_right():
    t = np.linspace(0, 2, 50)
    truth = np.tile(np.eye(4), (50, 1, 1))
    truth[:, :3, 3] = np.column_stack([np.cos(3 * t), np.sin(3 * t), t])
    mirrored = truth.copy()
    mirrored[:, 0, 3] *= -1
    assert trajectory.ate_rmse(mirrored, truth) > 0.1


def test_frames_without_truth_are_left_out(drive):
    estimate, truth = drive
    partial = truth.copy()
    partial[:16] = np.nan
    errors = trajectory.evaluate(estimate, partial)
    assert errors.frames == 224
    assert errors.ate_m == trajectory.ate_rmse(estimate[16:], truth[16:])


@pytest.mark.parametrize(("path_m", "longest"), [(71.0, 50.0), (145.0, 100.0), (393.0, 300.0), (5000.0, 800.0)])
def test_stretches_suit_the_path(path_m, longest):
    assert trajectory.stretch_lengths(path_m)[-1] == longest


def test_a_path_shorter_than_every_stretch_has_no_relative_error_and_says_so_in_json():
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 2, 3] = np.arange(5) * 0.5
    errors = trajectory.evaluate(T, T)
    assert math.isnan(errors.t_rel_percent)
    assert errors.as_json()["t_rel_percent"] is None


def test_trajectories_that_differ_in_length_are_refused(drive):
    estimate, truth = drive
    with pytest.raises(InputError, match="239 poses cannot be compared with 240"):
        trajectory.evaluate(estimate[1:], truth)


def test_too_little_truth_is_refused(drive):
    estimate, truth = drive
    with pytest.raises(InputError, match="truth knows 0 poses"):
        trajectory.evaluate(estimate, np.full_like(truth, np.nan))
