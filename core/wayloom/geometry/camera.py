"""Pinhole camera model and rectified stereo rig.

Camera axes: x right, y down, z forward. Pixel (0, 0) is the centre of the top-left pixel.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """An ideal camera: u = fx x/z + cx, v = fy y/z + cy. fx, fy, cx, cy in pixels; width, height in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def K(self) -> Array:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def at_level(self, level: int) -> "PinholeCamera":
        """The camera of pyramid level `level`, whose pixels are means of 2x2 pixels of the level below.

        The centre of the top-left pixel moves by half a pixel: c_l = (c + 0.5) / 2^l - 0.5.
        """
        s = 2.0**level
        return PinholeCamera(
            self.fx / s,
            self.fy / s,
            (self.cx + 0.5) / s - 0.5,
            (self.cy + 0.5) / s - 0.5,
            self.width >> level,
            self.height >> level,
        )

    def rays(self, uv: Array) -> Array:
        """uv (N, 2) pixels to (N, 3) directions in the camera frame with z = 1."""
        rays = np.empty((len(uv), 3))
        rays[:, 0], rays[:, 1], rays[:, 2] = (uv[:, 0] - self.cx) / self.fx, (uv[:, 1] - self.cy) / self.fy, 1.0
        return rays

    def project(self, points_cam: Array) -> Array:
        """points_cam (N, 3) m to uv (N, 2) pixels; NaN for points that are not in front of the camera."""
        z = np.where(points_cam[:, 2] > 0, points_cam[:, 2], np.nan)
        return np.column_stack([self.fx * points_cam[:, 0] / z + self.cx, self.fy * points_cam[:, 1] / z + self.cy])

    def contains(self, uv: Array, border_px: float = 0.0) -> NDArray[np.bool_]:
        """(N,) whether uv (N, 2) lies inside the image, at least border_px from its outermost pixel centres. NaN is outside."""
        u, v = uv[:, 0], uv[:, 1]
        return (u >= border_px) & (v >= border_px) & (u <= self.width - 1 - border_px) & (v <= self.height - 1 - border_px)


@dataclass(frozen=True, slots=True)
class StereoRig:
    """A rectified stereo pair: both images share one calibration matrix and one orientation.

    camera        the intrinsics of both images
    t_right_left  (3,) m: p_right = p_left + t_right_left. Ideally (-baseline, 0, 0); KITTI's colour pair is off by millimetres
                  in y and z, which matters, so all three are kept.
    """

    camera: PinholeCamera
    t_right_left: tuple[float, float, float]

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras along the common x axis, m."""
        return -self.t_right_left[0]

    @property
    def bf(self) -> float:
        """Baseline times focal length, px m: disparity = bf * inverse depth."""
        return self.baseline_m * self.camera.fx

    def with_baseline(self, ratio: float) -> "StereoRig":
        """The rig with a baseline `ratio` times as long."""
        if ratio == 1.0:
            return self
        tx, ty, tz = self.t_right_left
        return StereoRig(self.camera, (ratio * tx, ratio * ty, ratio * tz))
