"""The scale of a drive by its rig's lens: its gradient, and sigmas that hold."""

from dataclasses import replace

import numpy as np
import pytest
from made_observations import LENS, made_drive

from wayloom.calibration.adjustment import adjust
from wayloom.calibration.covariance import lens_covariance
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.residuals import drive_of
from wayloom.calibration.scale import LEAST_MOVE_M, ScaleGradient, scale_facts, scale_gradient, scale_sigma
from wayloom.calibration.settings import CalibrationSettings
from wayloom.geometry.lens import IDENTITY, PARAMETERS, RightLens, lens_from_values
from wayloom.odometry.rig.calibration_observations import CalibrationObservations

SETTINGS = CalibrationSettings(smallest_step=1e-4, iterations=60, robust_scale=1e4)
"""Squares all but: the gradient holds robust weights fixed, which an adjustment anew does not."""


def mean_log_length(observations: CalibrationObservations, lens: RightLens) -> float:
    """The slow twin: every pose adjusted anew with this lens, the drive's own offsets free."""
    held = np.diag(1e12 / SETTINGS.lens.sigmas**2)
    for _ in range(3):  # a lens that is held looks settled before the poses are
        fit = adjust([drive_of(observations)], SETTINGS, held, held @ (lens.values - IDENTITY.values), lens)
        observations = replace(observations, T_target_host=fit.states[0].T_target_host)
    lengths = np.linalg.norm(fit.states[0].T_target_host[:, :, :3, 3], axis=2)
    return float(np.log(lengths[lengths >= LEAST_MOVE_M]).mean())


@pytest.mark.parametrize("name", ["yaw_rad", "tz", "k1", "p2"])
def test_the_gradient_of_the_length_is_that_of_poses_adjusted_anew(name: str) -> None:
    drive = made_drive(LENS, 3, groups=6, outliers=0.0)
    gradient = scale_gradient(drive, LENS, SETTINGS)
    assert gradient is not None
    step = np.zeros(len(PARAMETERS))
    step[PARAMETERS.index(name)] = 0.002 * SETTINGS.lens.sigmas[PARAMETERS.index(name)]
    ahead, behind = (mean_log_length(drive, lens_from_values(LENS.values + sign * step)) for sign in (1, -1))
    assert gradient.by_lens @ step == pytest.approx((ahead - behind) / 2, rel=0.01, abs=1e-7)  # what poses that settle leave


def test_a_longer_baseline_is_a_longer_drive() -> None:
    gradient = ScaleGradient(np.zeros(10), 0.0)
    covariance = np.zeros((11, 11))
    covariance[10, 10] = 0.003**2
    assert scale_sigma(gradient, covariance) == pytest.approx(0.003, rel=0.01)


def test_the_error_of_the_scale_by_a_learnt_lens_keeps_to_its_sigma() -> None:
    errors = []
    for rig in range(6):
        file = learn_rig([made_drive(LENS, 100 * rig + k, group_px=0.05) for k in range(2)]).rig
        covariance = np.zeros((11, 11))
        covariance[:10, :10] = lens_covariance(file, SETTINGS)[0]
        facts = scale_facts(made_drive(LENS, 100 * rig + 9), file.lens, 1.0, covariance)
        assert facts is not None
        by_lens = float(np.array(facts["by_lens"]) @ (file.lens.values - LENS.values))
        assert facts["sigma"] == pytest.approx(facts["lens_sigma"])
        assert facts["lens_sigma"] < 3e-3
        errors.append(by_lens / facts["lens_sigma"])
    assert np.abs(errors).max() < 3.0  # of six normal errors, once in sixty such tests by chance; the seeds are fixed
    assert np.mean(np.square(errors)) < 2.8  # chi-square of six, once in a hundred


def test_a_drive_without_matches_tells_no_scale() -> None:
    drive = made_drive(LENS, 0, groups=3)
    rows = ("host_frame", "target_frame", "T_target_host", "group", "uv_host", "uv_right", "uv_left_target", "uv_right_target")
    assert scale_gradient(replace(drive, **{name: getattr(drive, name)[:0] for name in rows}), LENS) is None
