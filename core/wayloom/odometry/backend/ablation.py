"""Ablations of the marginalisation prior, to measure what its parts are worth. Nothing here runs with the default settings."""

import numpy as np

from wayloom.odometry.backend.window import Window
from wayloom.odometry.settings import Ablation

CURRENT_JACOBIANS = 2
"""In Frames.has_first: the prior knows the keyframe's first estimate, but Jacobians are taken at the current one."""


def weaken_prior(window: Window, ablation: Ablation, bias_information: float) -> None:
    """Take from the window's prior what `ablation` leaves out; called after each marginalisation.

    bias_information : of the disparity bias about its present value, where the prior shall know nothing else of it
    """
    if not ablation.marginalisation_prior:
        window.prior_H[:], window.prior_g[:] = 0.0, 0.0
        window.frames.has_first[:] = 0
    if not (ablation.bias_in_prior and ablation.marginalisation_prior):
        window.prior_H[0, :], window.prior_H[:, 0] = 0.0, 0.0
        window.prior_H[0, 0], window.prior_g[0] = bias_information, bias_information * window.disparity_bias[0]
    if not ablation.first_estimates:
        window.frames.has_first[:] = np.where(window.frames.has_first > 0, CURRENT_JACOBIANS, 0)
