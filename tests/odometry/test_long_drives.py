"""A drive to and fro through a made street, long enough for errors of the prior to add up if they did."""

import numpy as np
import pytest
from made_street import MadeLog

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.backend import marginalisation
from wayloom.odometry.backend.window import Window
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings

FRAMES, REACH_M, PERIOD = 240, 8.0, 60
RIG = StereoRig(PinholeCamera(100.0, 100.0, 79.5, 49.5, 160, 100), (-0.5, 0.0, 0.0))
SETTINGS = OdometrySettings(points=150, min_new_points=40, matched_points=80, candidates=500, sought_points=20)


def to_and_fro(frames: int) -> np.ndarray:
    """(frames, 4, 4) T_world_cam: along z between 0 and REACH_M and back, nodding and turning a little."""
    phase = 2.0 * np.pi * np.arange(frames) / PERIOD
    twists = np.zeros((frames, 6))
    twists[:, 2] = 0.5 * REACH_M * (1.0 - np.cos(phase))
    twists[:, 3], twists[:, 4] = 0.01 * np.sin(3.0 * phase), 0.03 * np.sin(phase)
    return np.array([se3.exp(twist) for twist in twists])


def scaled(H: np.ndarray) -> np.ndarray:
    """H with a unit diagonal; unknowns that nothing is known of are left out."""
    known = np.diag(H) > 1e-9
    H = H[np.ix_(known, known)]
    unit = 1.0 / np.sqrt(np.diag(H))
    return H * np.outer(unit, unit)


def test_the_prior_of_a_long_drive_stays_well_conditioned_and_its_errors_do_not_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    eigenvalues, biases = [], []
    original = marginalisation.marginalise

    def watched(window: Window, *arguments: object) -> None:
        original(window, *arguments)  # type: ignore[arg-type]
        eigenvalues.append(np.linalg.eigvalsh(scaled(window.prior_H))[[0, -1]])
        biases.append(float(window.disparity_bias[0]))
        assert np.array_equal(window.prior_H, window.prior_H.T)

    monkeypatch.setattr(marginalisation, "marginalise", watched)
    log = MadeLog(to_and_fro(FRAMES), rig=RIG, bias_px=0.2)
    result = track(log, SETTINGS)
    assert result.trajectory.tracked.all()
    assert len(eigenvalues) > 60
    low, high = np.array(eigenvalues).T
    assert (low > -1e-9 * high).all()
    third, condition = len(low) // 3, high / np.maximum(low, 1e-12)
    # Their quarter: with other choices of points it differs by 2.8 at most from one third of the drive to the next, their median by
    # 12, as a keyframe that little ties to the rest is worse by a hundred times.
    assert np.quantile(condition[-third:], 0.25) < 5.0 * np.quantile(condition[third : 2 * third], 0.25)
    assert abs(np.median(biases[-third:]) - 0.2) < 0.06
    assert np.ptp(biases[-third:]) < 0.03
    errors = np.linalg.norm(result.trajectory.T_world_cam[:, :3, 3] - log.truth[:, :3, 3], axis=1)
    per_lap = errors.reshape(-1, PERIOD).max(axis=1)
    assert per_lap[-1] < 0.2  # of 64 m, in images of 160 px: 0.09 and 0.13 m with two seeds
    assert np.diff(per_lap).max() < 0.1
