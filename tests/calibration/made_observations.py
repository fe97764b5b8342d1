"""Calibration observations of made drives: points of a street seen by a rig with a known lens, with noise and outliers."""

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.covariance import REGIONS
from wayloom.calibration.residuals import lens_of_drive
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import IDENTITY, RightLens, project_scaled
from wayloom.odometry.rig.calibration_observations import TARGETS, CalibrationObservations

FloatArray = NDArray[np.float64]
CAMERA = PinholeCamera(718.0, 716.0, 607.0, 185.0, 1241, 376)
RIG = StereoRig(CAMERA, (-0.537, 0.001, 0.0005))
LENS = RightLens(0.8e-3, -1.5e-3, 1.0e-3, 2e-3, -3e-3, 1.0015, -0.8, 0.008, -8e-4, 1.5e-3)
BORDER_PX = 8.0
RIGHT = [0, *range(1 + TARGETS, 1 + 2 * TARGETS)]
"""Of a point's matches, those in right images."""


def made_drive(
    lens: RightLens = IDENTITY,
    seed: int = 0,
    *,
    groups: int = 10,
    points: int = 80,
    turn_rad: float = 0.03,
    noise_px: float = 0.1,
    outliers: float = 0.05,
    group_px: float = 0.0,
    field_px: FloatArray | None = None,
    offsets: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rig_id: str | None = "made",
    rig: StereoRig = RIG,
) -> CalibrationObservations:
    """A drive of match groups that turn by about turn_rad a metre.

    group_px   sigma of an error that all right matches of one group share in a region of the image, in both directions
    field_px   (REGIONS[1], REGIONS[0], 2) errors that all right matches of the rig share in a region
    offsets    the drive's own disparity bias in px, pitch and roll in rad
    """
    rng = np.random.default_rng(seed)
    own, columns = lens_of_drive(lens, np.array(offsets)), []
    T_guess = np.zeros((groups, TARGETS, 4, 4))
    for s in range(groups):
        T, T_guess[s] = _motion(rng, turn_rad)
        uv, measured = _matches(rng, T, own, rig, points)
        measured += noise_px * rng.normal(size=measured.shape)
        if group_px or field_px is not None:
            shared = group_px * rng.normal(size=(*REGIONS[::-1], 2)) + (0.0 if field_px is None else field_px)
            measured[:, RIGHT] += shared[*_region(measured[:, RIGHT], rig.camera)]
        wrong = rng.random(measured.shape[:2]) < outliers
        measured[wrong] += rng.normal(0, 1.5, (int(wrong.sum()), 2))
        columns.append((np.full(len(uv), s), uv, measured))
    group, uv, measured = (np.concatenate(column) for column in zip(*columns, strict=True))
    frames = 10 * np.arange(groups)[:, None]
    return CalibrationObservations(
        f"drive {seed}", rig_id, rig, frames[:, 0].astype(np.int32), (frames + np.array([2, 5])).astype(np.int32), T_guess,
        group.astype(np.int32), uv.astype(np.int32), measured[:, 0].astype(np.float32),
        measured[:, 1 : 1 + TARGETS].astype(np.float32), measured[:, 1 + TARGETS :].astype(np.float32),
    )  # fmt: skip


def _region(pixels: FloatArray, camera: PinholeCamera) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of REGIONS in which pixels (..., 2) lie."""
    size = np.array([camera.width, camera.height]) / REGIONS
    across, down = np.moveaxis(np.clip(np.nan_to_num(pixels) // size, 0, np.array(REGIONS) - 1).astype(np.intp), -1, 0)
    return down, across


def _motion(rng: np.random.Generator, turn_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """(T, 4, 4) T_target_host of two targets 1.2 and 3.6 m ahead, and the same as an odometry would guess them."""
    yaw = turn_rad * rng.normal()
    xi = [[0.02 * rng.normal(), 0.02 * rng.normal(), -d, 0.003 * rng.normal(), d * yaw, 0.003 * rng.normal()] for d in (1.2, 3.6)]
    T = se3.exp(np.array(xi))
    return T, se3.exp(np.concatenate([0.02 * rng.normal(size=(2, 3)), 0.001 * rng.normal(size=(2, 3))], axis=1)) @ T


def _matches(
    rng: np.random.Generator, T: np.ndarray, lens: RightLens, rig: StereoRig, points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Host pixels (n, 2) and what is seen of them (n, 5, 2): ground, walls at both sides, and what is far away."""
    camera, t, n = rig.camera, np.array(rig.t_right_left), 4 * points
    uv = np.column_stack([rng.integers(20, camera.width - 20, n), rng.integers(20, camera.height - 20, n)])
    rays = camera.rays(uv.astype(float))
    rho = np.maximum.reduce([rays[:, 1] / 1.65, np.abs(rays[:, 0]) / rng.uniform(4, 9, n), 1 / rng.uniform(15, 80, n)])
    rho = np.minimum(rho, 0.35)

    def right(q: np.ndarray) -> np.ndarray:
        return project_scaled(lens, camera, rig.baseline_m, q + rho[:, None] * t, rho)

    def kept(pixels: np.ndarray) -> np.ndarray:
        return np.where(camera.contains(pixels, BORDER_PX)[:, None], pixels, np.nan)

    q = [rays @ pose[:3, :3].T + rho[:, None] * pose[:3, 3] for pose in T]
    seen = [kept(right(rays)), *(kept(camera.project(x)) for x in q), *(kept(right(x)) for x in q)]
    measured = np.stack(seen, axis=1)
    good = np.flatnonzero(np.isfinite(measured[:, 0, 0]))[:points]
    return uv[good], measured[good]
