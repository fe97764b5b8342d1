"""True camera geometry and optics: rays of the real lens, motion blur, and ground truth in the distorted image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import SKY
from wayloom.errors import ConfigError
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import R_real_ideal, RightLens
from wayloom.geometry.rectification import Coefficients, undistort
from wayloom.simulation.kernels import optics as kernels
from wayloom.simulation.kernels import raster
from wayloom.simulation.kernels.arrays import View
from wayloom.simulation.rendering.renderer import SAMPLES_PER_EDGE, Scene, Truth
from wayloom.simulation.sensors.camera import blurred
from wayloom.simulation.vehicle.rigs import given_rig, scale_of
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
NO_DISTORTION: Coefficients = (0.0, 0.0, 0.0, 0.0, 0.0)
MARGIN_PX = 3
"""Around what the lens sees, so that the filter finds neighbours."""
CULLING_SLACK = 0.02


@dataclass(frozen=True, slots=True)
class TrueCamera:
    """One camera as it is.

    width, height  of its images
    rendered       the ideal pinhole camera that is rendered for it
    T_left_cam     (4, 4) this camera in the left camera's frame
    lens_uv        (h, w, 2) float32, where each pixel of the image lies in the rendered one; None: they are the same
    """

    width: int
    height: int
    rendered: PinholeCamera
    T_left_cam: F64
    lens_uv: F32 | None = None


def true_cameras(vehicle: VehicleSettings, size: str) -> tuple[TrueCamera, TrueCamera]:
    """The true left and right camera. Raises ConfigError for an unknown size, and a lens that sees beyond the rendered image."""
    rig, lens = given_rig(vehicle, size), vehicle.right_lens.lens(scale_of(size))
    raw = vehicle.distortion or NO_DISTORTION
    return (
        _true_camera(rig.camera, RightLens(), raw, np.eye(4)),
        _true_camera(rig.camera, lens, raw, T_left_right(rig, lens)),
    )


def T_left_right(rig: StereoRig, lens: RightLens) -> F64:
    """(4, 4) the true right camera in the left camera's frame: p_real = R (p_left + t_right_left + baseline (0, ty, tz))."""
    t = np.array(rig.t_right_left) + rig.baseline_m * np.array([0.0, lens.ty, lens.tz])
    R = R_real_ideal(lens)
    return se3.inverse(se3.from_rotation_translation(R, R @ t))


def _true_camera(given: PinholeCamera, lens: RightLens, raw: Coefficients, T_left_cam: F64) -> TrueCamera:
    """A camera that the log calls `given`. `raw` bends the image first (seen from the file), then the lens's own distortion."""
    f = lens.focal_ratio
    pinhole = PinholeCamera(f * given.fx, f * given.fy, given.cx + lens.cx_shift_px, given.cy, given.width, given.height)
    own = (lens.k1, 0.0, lens.p1, lens.p2, 0.0)
    if not any(raw) and not any(own):
        return TrueCamera(given.width, given.height, pinhole, T_left_cam)
    v, u = np.mgrid[0 : given.height, 0 : given.width].astype(np.float64)
    xy = undistort(given.rays(np.column_stack([u.ravel(), v.ravel()]))[:, :2], raw)
    rectified = xy * (given.fx, given.fy) + (given.cx, given.cy)
    ideal = undistort(pinhole.rays(rectified)[:, :2], own)
    uv = ideal * (pinhole.fx, pinhole.fy) + (pinhole.cx, pinhole.cy)
    dark = int((~np.isfinite(uv).all(axis=1)).sum())
    if dark:
        what = f"{dark} of {len(uv)} pixels see nothing through the lens, whose polynomial folds within the image"
        raise ConfigError(what, record="distortion", remedy="weaken it, or take a rig of longer focal length")
    low = np.floor(uv.min(axis=0)).astype(int) - MARGIN_PX
    high = np.ceil(uv.max(axis=0)).astype(int) + MARGIN_PX
    width, height = (int(n) for n in high - low + 1)
    rendered = PinholeCamera(pinhole.fx, pinhole.fy, pinhole.cx - int(low[0]), pinhole.cy - int(low[1]), width, height)
    lens_uv = (uv - low).reshape(given.height, given.width, 2).astype(np.float32)
    return TrueCamera(given.width, given.height, rendered, T_left_cam, lens_uv)


def culling_camera(cameras: tuple[TrueCamera, ...]) -> PinholeCamera:
    """A camera at the left one's position whose view contains those of all, for culling."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for camera in cameras:
        c = camera.rendered
        corners = np.array([(x, y) for x in (-0.5, c.width - 0.5) for y in (-0.5, c.height - 0.5)])
        rays = c.rays(corners) @ camera.T_left_cam[:3, :3].T
        xy = rays[:, :2] / rays[:, 2:]
        low, high = np.minimum(low, xy.min(axis=0)), np.maximum(high, xy.max(axis=0))
    low, high = low - CULLING_SLACK, high + CULLING_SLACK
    f = cameras[0].rendered.fx
    width, height = (int(np.ceil(n)) for n in f * (high - low))
    return PinholeCamera(f, f, float(-f * low[0]) - 0.5, float(-f * low[1]) - 0.5, width, height)


def truth_of(scene: Scene, camera: TrueCamera, T_world_cam: F64, fine_ids: NDArray[np.int32] | None = None) -> Truth:
    """Ground truth of the ray through each pixel's centre, with depth along the true camera's z.

    Where the lens bends, class and instance are those seen at most a quarter of a pixel (along each axis) from the ray; depth is
    where the ray itself meets that triangle's plane. fine_ids: `Scene.fine_ids` of the drawn camera, where they are at hand.
    """
    if camera.lens_uv is None:
        return scene.truth(camera.rendered, T_world_cam)
    c = camera.rendered
    all_ids = scene.fine_ids(c, T_world_cam) if fine_ids is None else fine_ids
    place = np.rint(SAMPLES_PER_EDGE * camera.lens_uv + 0.5 * (SAMPLES_PER_EDGE - 1)).astype(np.int64)
    ids = all_ids[place[..., 1], place[..., 0]]
    depth = np.empty(ids.size, np.float32)
    u, v = (np.ascontiguousarray(camera.lens_uv[..., k]).ravel() for k in (0, 1))
    kernels.depth_along(ids.ravel(), u, v, _view(c, T_world_cam), scene.mesh.corners, depth)
    seen = ids != raster.NO_TRIANGLE
    return Truth(
        depth.reshape(ids.shape),
        np.where(seen, scene.mesh.class_id[ids], SKY).astype(np.uint8),
        np.where(seen, scene.mesh.instance[ids], 0).astype(np.uint16),
    )


def through_lens(radiance: F32, camera: TrueCamera, blur_px: float, depth: F32 | None = None, motion: F64 | None = None) -> F32:
    """(h, w, 3) light on the sensor, from the rendered radiance.

    depth  (h, w) m along z, 0 infinitely far; motion (6,) twist m, rad of the camera, in its own axes, while the shutter is open.
    Both or none: then nothing moves. Moving objects are blurred by the camera's motion only.
    """
    if camera.lens_uv is None and motion is None:
        return blurred(radiance, blur_px)
    b = 3.0 * blur_px**2
    out = np.empty((camera.height, camera.width, 3), np.float32)
    lens_uv = np.empty((0, 0, 2), np.float32) if camera.lens_uv is None else camera.lens_uv
    opening = closing = np.eye(4)[:3]
    depths = np.empty((0, 0), np.float32)
    if motion is not None and depth is not None:
        opening, closing, depths = se3.exp(0.5 * motion)[:3], se3.exp(-0.5 * motion)[:3], depth
    kernels.through_lens(radiance, lens_uv, depths, _view(camera.rendered, np.eye(4)), opening, closing, np.float32(b), out)
    return out


def _view(camera: PinholeCamera, T_world_cam: F64) -> View:
    return View(camera.fx, camera.fy, camera.cx, camera.cy, T_world_cam)
