"""Lens distortion, radial-tangential (Brown 1966) and equidistant (Kannala and Brandt 2006), and the maps that rectify an image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera

Array = NDArray[np.float64]
Coefficients = tuple[float, float, float, float, float]
FisheyeCoefficients = tuple[float, float, float, float]
NO_COEFFICIENT = 1e-12
NEWTON_STEPS, LARGEST_STEP, SMALLEST_DETERMINANT, UNDISTORTED_TO = 25, 0.3, 1e-6, 1e-10


@dataclass(frozen=True, slots=True)
class DistortedCamera:
    """A real camera with the radial-tangential lens (Brown 1966, OpenCV's order of coefficients).

    camera       its intrinsics
    distortion   k1, k2, p1, p2, k3, on normalised coordinates
    """

    camera: PinholeCamera
    distortion: Coefficients


@dataclass(frozen=True, slots=True)
class FisheyeCamera:
    """A real camera with the equidistant lens (Kannala and Brandt 2006, OpenCV's `fisheye`).

    camera       its intrinsics
    distortion   k1 to k4: a ray at theta rad from the axis falls at theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
    """

    camera: PinholeCamera
    distortion: FisheyeCoefficients


LensCamera = DistortedCamera | FisheyeCamera


def distort(xy: Array, distortion: Coefficients) -> Array:
    """Normalised ideal coordinates (N, 2), x/z and y/z, to where the lens puts them, (N, 2).

    x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), and p1, p2 exchanged for y.
    """
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    out = np.empty((len(xy), 2))  # column_stack takes several times as long for few points
    out[:, 0] = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    out[:, 1] = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return out


def distortion_jacobian(xy: Array, distortion: Coefficients) -> Array:
    """The derivative of `distort` at xy (N, 2), (N, 2, 2); symmetric."""
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r2
    out = np.empty((len(xy), 2, 2))
    out[:, 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    out[:, 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    out[:, 0, 1] = out[:, 1, 0] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    return out


def undistort(xy_distorted: Array, distortion: Coefficients) -> Array:
    """The inverse of `distort`, (N, 2) to (N, 2), by Newton's method; NaN where the lens has none that it finds."""
    xy = xy_distorted.copy()
    for _ in range(NEWTON_STEPS):
        J = distortion_jacobian(xy, distortion)
        rest = xy_distorted - distort(xy, distortion)
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] ** 2
        det = np.where(np.abs(det) < SMALLEST_DETERMINANT, SMALLEST_DETERMINANT, det)
        step_x = (J[:, 1, 1] * rest[:, 0] - J[:, 0, 1] * rest[:, 1]) / det
        step_y = (J[:, 0, 0] * rest[:, 1] - J[:, 0, 1] * rest[:, 0]) / det
        xy = xy + np.clip(np.column_stack([step_x, step_y]), -LARGEST_STEP, LARGEST_STEP)
    found = np.abs(xy_distorted - distort(xy, distortion)).max(axis=1) < UNDISTORTED_TO
    return np.where(found[:, None], xy, np.nan)


def fold_radius(distortion: Coefficients) -> float:
    """The ideal radius from which on the polynomial runs backwards, so that no real lens is like it: infinite where it never does.

    The smallest positive root of d/dr (r + k1 r^3 + k2 r^5 + k3 r^7) = 1 + 3 k1 q + 5 k2 q^2 + 7 k3 q^3, q = r^2.
    """
    k1, k2, _, _, k3 = distortion
    coefficients = np.array([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    roots = np.roots(np.where(np.abs(coefficients) < NO_COEFFICIENT, 0.0, coefficients))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if len(real) else float("inf")


def fisheye_radius(theta: Array, distortion: FisheyeCoefficients) -> Array:
    """Angles from the axis (N,) rad to radii (N,) in normalised coordinates."""
    k1, k2, k3, k4 = distortion
    q = theta * theta
    return np.asarray(theta * (1.0 + q * (k1 + q * (k2 + q * (k3 + q * k4)))))


def fisheye_fold(distortion: FisheyeCoefficients) -> float:
    """The angle, rad, from which on the polynomial runs backwards: pi where it never does.

    The smallest positive root of d/dtheta = 1 + 3 k1 q + 5 k2 q^2 + 7 k3 q^3 + 9 k4 q^4, q = theta^2.
    """
    k1, k2, k3, k4 = distortion
    coefficients = np.array([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    roots = np.roots(np.where(np.abs(coefficients) < NO_COEFFICIENT, 0.0, coefficients))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return min(float(np.sqrt(real.min())), np.pi) if len(real) else float(np.pi)


def fisheye_angle(radius: Array, distortion: FisheyeCoefficients) -> Array:
    """The inverse of `fisheye_radius`, (N,) to (N,) rad, by Newton's method; NaN where the lens has none below its fold."""
    fold = fisheye_fold(distortion)
    k1, k2, k3, k4 = distortion
    theta = np.minimum(radius, 0.5 * fold)
    for _ in range(NEWTON_STEPS):
        q = theta * theta
        slope = 1.0 + q * (3.0 * k1 + q * (5.0 * k2 + q * (7.0 * k3 + q * 9.0 * k4)))
        step = (radius - fisheye_radius(theta, distortion)) / np.maximum(slope, SMALLEST_DETERMINANT)
        theta = np.clip(theta + np.clip(step, -LARGEST_STEP, LARGEST_STEP), 0.0, fold)
    return np.where(np.abs(radius - fisheye_radius(theta, distortion)) < UNDISTORTED_TO, theta, np.nan)


def project_distorted(rays: Array, lens: LensCamera) -> Array:
    """rays (N, 3) in the distorted camera's frame to uv (N, 2) pixels of its image; NaN for rays that do not point forward or
    that lie beyond the lens's fold."""
    z = np.where(rays[:, 2] > 0, rays[:, 2], np.nan)
    ideal = rays[:, :2] / z[:, None]
    radius = np.hypot(ideal[:, 0], ideal[:, 1])
    if isinstance(lens, FisheyeCamera):
        theta = np.arctan(radius)
        theta[theta >= fisheye_fold(lens.distortion)] = np.nan
        xy = ideal * (fisheye_radius(theta, lens.distortion) / np.maximum(radius, NO_COEFFICIENT))[:, None]
    else:
        ideal[radius >= fold_radius(lens.distortion)] = np.nan
        xy = distort(ideal, lens.distortion)
    c = lens.camera
    return np.column_stack([c.fx * xy[:, 0] + c.cx, c.fy * xy[:, 1] + c.cy])


def distorted_rays(uv: Array, lens: LensCamera) -> Array:
    """The inverse of `project_distorted`: uv (N, 2) pixels to rays (N, 3) with z = 1; NaN where no ray before the camera falls."""
    c = lens.camera
    xy = np.column_stack([(uv[:, 0] - c.cx) / c.fx, (uv[:, 1] - c.cy) / c.fy])
    if isinstance(lens, FisheyeCamera):
        radius = np.hypot(xy[:, 0], xy[:, 1])
        theta = fisheye_angle(radius, lens.distortion)
        theta[theta >= 0.5 * np.pi] = np.nan
        ideal = xy * (np.tan(theta) / np.maximum(radius, NO_COEFFICIENT))[:, None]
        ideal[radius < NO_COEFFICIENT] = 0.0
    else:
        ideal = undistort(xy, lens.distortion)
        ideal[~(np.hypot(ideal[:, 0], ideal[:, 1]) < fold_radius(lens.distortion))] = np.nan
    return np.column_stack([ideal, np.ones(len(ideal))])


def rectifying_maps(
    lens: LensCamera, R_rect_cam: Array, rectified: PinholeCamera
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sampling maps of rectification: u and v, each (h, w) float32, of the distorted image for each rectified pixel.

    R_rect_cam (3, 3) turns the distorted camera's axes into the rectified ones (KITTI's R_rect).
    """
    v, u = np.mgrid[0 : rectified.height, 0 : rectified.width].astype(np.float64)
    rays = rectified.rays(np.column_stack([u.ravel(), v.ravel()])) @ R_rect_cam  # R_rect_cam^T on each row
    uv = project_distorted(rays, lens).reshape(rectified.height, rectified.width, 2)
    uv = np.nan_to_num(uv, nan=-1e6)
    return uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32)
