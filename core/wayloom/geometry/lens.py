"""Relative lens model of a stereo rig's right camera: its rotation, offset, focal length and distortion against the ideal one.

The ideal right camera shares the left one's intrinsics and axes and stands at t_right_left. A point p in its frame (m) is in the
real one's

    p_real = R_real_ideal (p + baseline (0, ty, tz)),      R_real_ideal = Rz(roll) Ry(yaw) Rx(pitch),

and its pixel, with (x, y) = p_real's x/z and y/z put through the lens of k1, p1, p2 (Brown 1966, as in `geometry.rectification`),

    u = focal_ratio fx x_d + cx + cx_shift_px,             v = focal_ratio fy y_d + cy.

To first order, at infinity, in pixels: du = f (yaw (1 + x^2) - pitch x y - roll y + (focal_ratio - 1) x + k1 x r^2 + 2 p1 x y
+ p2 (r^2 + 2 x^2)) + cx_shift and dv = f (-pitch (1 + y^2) + yaw x y + roll x + (focal_ratio - 1) y + k1 y r^2 + p1 (r^2 + 2 y^2)
+ 2 p2 x y). cx_shift_px is the opposite of the odometry's disparity bias: u_right = u_left - bf rho - delta.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.rectification import distort, distortion_jacobian, undistort

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RightLens:
    """The ten parameters; the default is the ideal camera.

    pitch_rad, yaw_rad, roll_rad  turn the ideal camera's axes into the real ones, about x, then y, then z
    ty, tz        added to t_right_left, as shares of the baseline
    focal_ratio   focal length over the ideal one
    cx_shift_px   shift of the principal point along the rows, px
    k1, p1, p2    radial and tangential distortion on normalised coordinates
    """

    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    roll_rad: float = 0.0
    ty: float = 0.0
    tz: float = 0.0
    focal_ratio: float = 1.0
    cx_shift_px: float = 0.0
    k1: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def values(self) -> Array:
        """(10,) the parameters in the order of PARAMETERS."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    @property
    def is_ideal(self) -> bool:
        """Whether it changes nothing."""
        return self == RightLens()

    def real_pixels(self, camera: PinholeCamera, baseline_m: float, uv_ideal: Array, inverse_depth: Array | float = 0.0) -> Array:
        """Pixels (N, 2) of the ideal right image to those of the real one, (N, 2).

        camera : the intrinsics of the ideal cameras; inverse_depth : (N,) or one number, 1/m along the ideal right camera's z,
        needed for ty and tz only. NaN where the point is not in front of the real camera.
        """
        rho = np.broadcast_to(np.asarray(inverse_depth, float), len(uv_ideal))
        return project_scaled(self, camera, baseline_m, camera.rays(uv_ideal), rho)

    def ideal_pixels(self, camera: PinholeCamera, baseline_m: float, uv_real: Array, inverse_depth: Array | float = 0.0) -> Array:
        """The inverse of `real_pixels` at the same inverse depths; NaN where the lens has none."""
        rho = np.broadcast_to(np.asarray(inverse_depth, float), len(uv_real))
        f, shift = self.focal_ratio, self.cx_shift_px
        xy = np.column_stack([(uv_real[:, 0] - camera.cx - shift) / (f * camera.fx), (uv_real[:, 1] - camera.cy) / (f * camera.fy)])
        rays = np.column_stack([undistort(xy, self._distortion), np.ones(len(xy))]) @ R_real_ideal(self)  # R^T on each row
        z = np.where(rays[:, 2] > 0, rays[:, 2], np.nan)
        q = rays * ((1.0 + rho * baseline_m * self.tz) / z)[:, None]
        return np.column_stack(
            [camera.fx * q[:, 0] + camera.cx, camera.fy * (q[:, 1] - rho * baseline_m * self.ty) + camera.cy]
        )  # fmt: skip

    @property
    def _distortion(self) -> tuple[float, float, float, float, float]:
        return (self.k1, 0.0, self.p1, self.p2, 0.0)


PARAMETERS = tuple(field.name for field in fields(RightLens))
IDENTITY = RightLens()


def lens_from_values(values: Array) -> RightLens:
    """The lens of (10,) numbers in the order of PARAMETERS."""
    return RightLens(*(float(value) for value in values))


def project_scaled(lens: RightLens, camera: PinholeCamera, baseline_m: float, q_right: Array, rho: Array) -> Array:
    """Pixels (N, 2) in the real right image of the points q_right / rho of the ideal right camera's frame; rho 0 is infinitely far.

    q_right : (N, 3), a point times its rho; rho : (N,) 1/m. NaN for points behind the real camera.
    """
    p = _real_scaled(lens, baseline_m, q_right, rho)
    z = np.where(p[:, 2] > 0, p[:, 2], np.nan)
    xy = distort(p[:, :2] / z[:, None], lens._distortion)
    f = lens.focal_ratio
    uv = np.empty((len(xy), 2))
    uv[:, 0] = f * camera.fx * xy[:, 0] + camera.cx + lens.cx_shift_px
    uv[:, 1] = f * camera.fy * xy[:, 1] + camera.cy
    return uv


def projection_jacobians(
    lens: RightLens, camera: PinholeCamera, baseline_m: float, q_right: Array, rho: Array
) -> tuple[Array, Array, Array]:
    """Derivatives of `project_scaled` by q_right (N, 2, 3), by rho (N, 2) and by the parameters (N, 2, 10)."""
    p = _real_scaled(lens, baseline_m, q_right, rho)
    z = np.where(p[:, 2] > 0, p[:, 2], np.nan)
    xy = p[:, :2] / z[:, None]
    focal = lens.focal_ratio * np.array([camera.fx, camera.fy])
    pinhole = np.zeros((len(p), 2, 3))  # d(x, y)/dp
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = 1.0 / z
    pinhole[:, :, 2] = -xy / z[:, None]
    by_real = focal[:, None] * (distortion_jacobian(xy, lens._distortion) @ pinhole)
    R = R_real_ideal(lens)
    by_q = by_real @ R
    t = baseline_m * np.array([0.0, lens.ty, lens.tz])
    by_parameters = np.empty((len(p), 2, len(PARAMETERS)))
    moved = q_right + rho[:, None] * t
    for i, dR in enumerate(rotation_derivatives(lens)):
        by_parameters[:, :, i] = np.einsum("nij,nj->ni", by_real, moved @ dR.T)
    by_parameters[:, :, 3:5] = by_q[:, :, 1:] * (baseline_m * rho)[:, None, None]
    by_parameters[:, :, 5] = distort(xy, lens._distortion) * np.array([camera.fx, camera.fy])
    by_parameters[:, :, 6] = (1.0, 0.0)
    by_parameters[:, :, 7:] = focal[:, None] * _distortion_by_coefficients(xy)
    return by_q, by_q @ t, by_parameters


def parameter_jacobian(
    lens: RightLens, camera: PinholeCamera, baseline_m: float, uv_ideal: Array, inverse_depth: Array | float = 0.0
) -> Array:
    """(N, 2, 10): derivatives of `real_pixels` by the parameters, in the order of PARAMETERS."""
    rho = np.broadcast_to(np.asarray(inverse_depth, float), len(uv_ideal))
    return projection_jacobians(lens, camera, baseline_m, camera.rays(uv_ideal), rho)[2]


def lens_field(lens: RightLens, camera: PinholeCamera, step: int = 1) -> Array:
    """Displacement by the lens at infinite depth: (h, w, 2) px, du and dv = real - ideal, at every `step`-th pixel."""
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step].astype(np.float64)
    uv = np.column_stack([u.ravel(), v.ravel()])
    return np.asarray((lens.real_pixels(camera, 0.0, uv) - uv).reshape(*u.shape, 2))


def at_infinity(lens: RightLens) -> RightLens:
    """The lens without its displacement: with `displaced` it is the whole lens at every depth."""
    return lens_from_values(np.where(np.isin(PARAMETERS, ("ty", "tz")), 0.0, lens.values))


def displaced(rig: StereoRig, lens: RightLens) -> StereoRig:
    """The rig whose t_right_left holds the lens's ty and tz: an image warped by `at_infinity(lens)` is exactly its right one,
    because the displacement comes before rotation and lens."""
    tx, ty, tz = rig.t_right_left
    return StereoRig(rig.camera, (tx, ty + rig.baseline_m * lens.ty, tz + rig.baseline_m * lens.tz))


@lru_cache(256)
def R_real_ideal(lens: RightLens) -> Array:
    """(3, 3), read-only: Rz(roll) Ry(yaw) Rx(pitch)."""
    Rx, Ry, Rz = _axis_rotations(lens)
    R = np.asarray(Rz @ Ry @ Rx)
    R.setflags(write=False)
    return R


def _real_scaled(lens: RightLens, baseline_m: float, q_right: Array, rho: Array) -> Array:
    """(N, 3): the points times rho in the real camera's frame."""
    t = baseline_m * np.array([0.0, lens.ty, lens.tz])
    return np.asarray((q_right + rho[:, None] * t) @ R_real_ideal(lens).T)


def _axis_rotations(lens: RightLens) -> tuple[Array, Array, Array]:
    (sx, sy, sz), (cx, cy, cz) = (f(np.array([lens.pitch_rad, lens.yaw_rad, lens.roll_rad])) for f in (np.sin, np.cos))
    Rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    Rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return Rx, Ry, Rz


def rotation_derivatives(lens: RightLens) -> tuple[Array, Array, Array]:
    """dR_real_ideal / d pitch, yaw, roll, each (3, 3): an axis's derivative is its generator times its rotation."""
    Rx, Ry, Rz = _axis_rotations(lens)
    Gx = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    Gy = np.array([[0.0, 0, 1], [0, 0, 0], [-1, 0, 0]])
    Gz = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
    return Rz @ Ry @ Gx @ Rx, Rz @ Gy @ Ry @ Rx, Gz @ Rz @ Ry @ Rx


def _distortion_by_coefficients(xy: Array) -> Array:
    """(N, 2, 3): derivatives of `distort` at xy (N, 2) by k1, p1, p2."""
    x, y = xy.T
    r2 = x * x + y * y
    rows = [[x * r2, 2.0 * x * y, r2 + 2.0 * x * x], [y * r2, r2 + 2.0 * y * y, 2.0 * x * y]]
    return np.asarray(np.moveaxis(np.array(rows), 2, 0))
