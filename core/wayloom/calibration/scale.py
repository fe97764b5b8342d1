"""Scale of a drive by its rig's lens: how the odometry's length follows the ten parameters, and the standard deviation of that.

A drive's length is measured by its disparities. With the lens held, a match group's two target poses follow from its matches; their
lengths l change with the lens x and with the drive's own offsets o (bias, pitch, roll), which follow the lens in turn:

    d log l = a^T dx,    a = l_x + l_o do/dx,    do/dx = -H_oo^-1 H_ox,

l_x and l_o by the back-substitution of the bundle adjustment (`adjustment.GroupEquations.pose_gain`). With the rig's covariance C
of (x, log b), b the baseline's ratio to the given one,

    sigma^2 = (a, 1)^T C (a, 1) + l_o V l_o^T + floor^2,

V being the covariance of the drive's own offsets by its groups' scores. Baseline and focal length of both cameras together scale a
drive as a whole: no image tells them apart from its length, so b stands for both.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.adjustment import LEAVE, Adjustment, adjust, drive_offsets
from wayloom.calibration.residuals import KEPT, LENS, drive_of
from wayloom.calibration.settings import CalibrationSettings
from wayloom.geometry.lens import RightLens
from wayloom.odometry.rig.calibration_observations import TARGETS, CalibrationObservations

FloatArray = NDArray[np.float64]
HELD: Final = 1e-6
"""Of a parameter's prior sigma: so firmly the lens is held while poses follow it."""
LEAST_MOVE_M: Final = 0.3
"""A target nearer to its host says little of length."""
FLOOR: Final = 3e-4
"""What drives of rigs without fault err by: docs/calibration.md#what-falls-short."""


@dataclass(frozen=True, slots=True)
class ScaleGradient:
    """by_lens (10,): d log length / d lens, the drive's own offsets following; own_sigma: of log length by these offsets alone."""

    by_lens: FloatArray
    own_sigma: float


def scale_gradient(
    observations: CalibrationObservations, lens: RightLens, settings: CalibrationSettings = CalibrationSettings()
) -> ScaleGradient | None:
    """How a drive's length follows the lens that it is tracked with; None for a drive that hardly moved."""
    held = np.diag(1.0 / (HELD * settings.lens.sigmas) ** 2)
    fit = adjust([drive_of(observations)], settings, held, held @ (lens.values - RightLens().values), lens)
    by_kept = _length_by_kept(fit)
    if by_kept is None:
        return None
    gain, covariance = drive_offsets(fit, 0, settings)
    by_offsets = by_kept[LEAVE]
    return ScaleGradient(by_kept[:LENS] - by_offsets @ gain, float(np.sqrt(by_offsets @ covariance @ by_offsets)))


def scale_sigma(gradient: ScaleGradient, covariance: FloatArray) -> float:
    """Standard deviation of log length; covariance (11, 11) of the lens tracked with and of log baseline ratio."""
    a = np.append(gradient.by_lens, 1.0)
    return float(np.sqrt(a @ covariance @ a + gradient.own_sigma**2 + FLOOR**2))


def scale_facts(
    observations: CalibrationObservations,
    lens: RightLens,
    baseline_ratio: float,
    covariance: FloatArray,
    settings: CalibrationSettings = CalibrationSettings(),
) -> dict[str, Any] | None:
    """JSON-ready: `sigma` of the drive's scale, `lens_sigma` of it by the lens alone (the given baseline taken as true),
    `own_sigma` by the drive's own offsets, and with `by_lens`, `lens` and `baseline_ratio` what GNSS needs to tell them."""
    gradient = scale_gradient(observations, lens, settings)
    if gradient is None:
        return None
    of_lens = covariance.copy()
    of_lens[LENS, :] = of_lens[:, LENS] = 0.0
    return {
        "sigma": scale_sigma(gradient, covariance),
        "lens_sigma": scale_sigma(gradient, of_lens),
        "own_sigma": gradient.own_sigma,
        "by_lens": gradient.by_lens.tolist(),
        "lens": (lens.values - RightLens().values).tolist(),
        "baseline_ratio": baseline_ratio,
    }  # fmt: skip


def _length_by_kept(fit: Adjustment) -> FloatArray | None:
    """(14,) mean over targets of d log |t| by lens, offsets and kappa: t' = t + v + omega x t, so d|t|/|t| = t^T v / |t|^2."""
    rows = []
    for group, T in zip(fit.equations[0], fit.states[0].T_target_host, strict=True):
        for k in range(TARGETS):
            t = T[k, :3, 3]
            if (square := float(t @ t)) >= LEAST_MOVE_M**2:
                rows.append(-t @ group.pose_gain[6 * k : 6 * k + 3, :KEPT] / square)
    return np.mean(rows, axis=0) if rows else None
