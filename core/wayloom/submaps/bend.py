"""Bend of a submap: by how much the drive's graph has its keyframes elsewhere than the rigid submap.

A submap's content is the odometry's, and rigid. Where traffic or hard light misled the odometry within it, GNSS or loops bend the
drive there, and what is measured at one end of the submap says little of the other. The graph's own noise bends it too: fixes that
wander by decimetres pull a good odometry along. With b the shift of a keyframe against the submap, d its distance from the anchor
and s the graph's sigma of it, the odometry's error o is estimated by its moments, and the variance b^2 is shrunk by its share:
    o^2 = max(b^2 - s^2, 0) + (DRIFT_SHARE d)^2,   bend^2 = b^2 o^2 / (o^2 + s^2).
The sigma s grows with d from that of the steps S to the neighbouring anchors, L metres away: s^2 = tr(S) (d / L)^2.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.georeference.types import GeoReference

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
DRIFT_SHARE: Final = 0.003
"""Of the road, by which a good odometry errs within a submap, sigma."""


def noticed(bend: FloatArray, T_submap_cam: FloatArray, stretch2: float) -> FloatArray:
    """The bends (K, 6) of keyframes at T_submap_cam (K, 4, 4) as one-sigma errors, as far as they are more than the graph's noise.

    stretch2 : variance of the graph's step to a neighbouring anchor for each m^2 of its length; 0 where none is known
    """
    p = T_submap_cam[:, :3, 3]
    b2 = ((bend[:, :3] + np.cross(bend[:, 3:], p)) ** 2).sum(axis=1)
    d2 = (p**2).sum(axis=1)
    s2 = stretch2 * d2
    o2 = np.maximum(b2 - s2, 0.0) + DRIFT_SHARE**2 * d2
    share = np.divide(o2, o2 + s2, out=np.zeros(len(p)), where=o2 + s2 > 0.0)
    return np.asarray(np.sqrt(share)[:, None] * bend)


def stretches2(geo: GeoReference, anchors: IntArray) -> FloatArray:
    """(S,) of each submap, of anchor frames (S,), the variance of its steps to the neighbouring anchors for each m^2 of their way;
    0 where none is told."""
    total, count = np.zeros(len(anchors)), np.zeros(len(anchors))
    if np.array_equal(geo.anchors.frame, anchors) and len(anchors) > 1:
        p, P, C = geo.T_enu_cam[anchors, :3, 3], geo.covariance[anchors], geo.anchors.cross
        middle = se3.from_rotation_translation(np.tile(np.eye(3), (len(C), 1, 1)), -0.5 * (p[:-1] + p[1:]))
        Ad = se3.adjoint(middle)
        D = Ad @ (P[:-1] + P[1:] - C - np.swapaxes(C, 1, 2)) @ np.swapaxes(Ad, 1, 2)
        of_step = np.trace(D[:, :3, :3], axis1=1, axis2=2) / np.maximum(((p[1:] - p[:-1]) ** 2).sum(axis=1), 1.0)
        rows = np.flatnonzero(geo.anchors.connected & np.isfinite(of_step))
        for ends in (rows, rows + 1):
            total[ends] += np.maximum(of_step[rows], 0.0)
            count[ends] += 1.0
    return np.asarray(total / np.maximum(count, 1.0))
