"""Up by the street under the car: its cross fall is small, its slope is not.

A plane through the points of the road near the camera says how the camera rolls against the street; how far the street itself leans
to a side (1 to 2.5 % for the rain, the same way all along it) is the noise, so neighbouring sections are no new witnesses.
"""

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.georeference.gravity.sections import Section
from wayloom.georeference.gravity.uprights import WIDE_RAD, Lean, fitted

FloatArray = NDArray[np.float64]
ROAD = CLASS_ID["road"]
MIN_POINTS, MIN_WIDTH_M, HALF_WIDTH_M = 30, 0.8, 5.0
CROSS_FALL_RAD = 0.015
"""From one section to another that is far away."""


def lean_by_street(section: Section) -> Lean | None:
    """None where too little of the road was seen. Ahead it says nothing."""
    T_cam_level = np.linalg.inv(section.T_level_cam)
    p = section.points_level[section.label == ROAD]
    right_m = p @ T_cam_level[0, :3] + T_cam_level[0, 3]
    near = np.abs(right_m) < HALF_WIDTH_M
    p = p[near] - p[near].mean(axis=0) if near.any() else p[near]
    if len(p) < MIN_POINTS or right_m[near].std() < MIN_WIDTH_M:
        return None
    slope, covariance = fitted(np.column_stack([p[:, :2], np.ones(len(p))]), p[:, 2])
    right = section.T_level_cam[:2, 0] / np.linalg.norm(section.T_level_cam[:2, 0])
    sigma2 = CROSS_FALL_RAD**2 + float(right @ covariance[:2, :2] @ right)
    across = np.outer(right, right)
    return Lean(-(right @ slope[:2]) * right, sigma2 * across + WIDE_RAD**2 * (np.eye(2) - across), np.zeros(0))
