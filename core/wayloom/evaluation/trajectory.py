"""Trajectory error metrics: ATE, relative errors as in KITTI, length ratio.

ATE            root mean square position error after the best rigid alignment, no scale (Sturm et al. 2012, eq. 4 and 5)
t_rel, r_rel   mean translation and rotation error over stretches of given lengths (Geiger et al., KITTI odometry, 2012)
frame error    root mean square error of the motion from one frame to the next
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.georeference.rigid import align_rigid

FloatArray = NDArray[np.float64]
KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
SHORT_LENGTHS_M = (25.0, 50.0, 75.0, 100.0)
TINY_LENGTHS_M = (10.0, 20.0, 30.0, 40.0, 50.0)


@dataclass(frozen=True, slots=True)
class TrajectoryErrors:
    """Errors of an estimate against truth.

    frames                 poses that were compared
    truth_m, estimate_m    path lengths, m
    length_ratio           estimate_m / truth_m
    ate_m                  m
    t_rel_percent          % of the stretch; NaN where the path is shorter than every stretch
    r_rel_deg_per_100m     degrees per 100 m; NaN likewise
    frame_translation_m, frame_rotation_deg   from one frame to the next
    """

    frames: int
    truth_m: float
    estimate_m: float
    length_ratio: float
    ate_m: float
    t_rel_percent: float
    r_rel_deg_per_100m: float
    frame_translation_m: float
    frame_rotation_deg: float

    def as_json(self) -> dict[str, float | None]:
        """Field name to value; None for what is not defined."""
        return {name: value if np.isfinite(value) else None for name, value in asdict(self).items()}


def path_length(positions: FloatArray) -> float:
    """Length in m of the polyline through positions (N, 3) m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def ate_rmse(T_estimate: FloatArray, T_truth: FloatArray) -> float:
    """ATE in m of poses T_estimate against T_truth, both (N, 4, 4) T_world_cam in world frames that need not agree."""
    estimate, truth = T_estimate[:, :3, 3], T_truth[:, :3, 3]
    T = align_rigid(estimate, truth, np.ones(len(truth)))
    return float(np.sqrt(np.mean(np.sum((se3.transform(T, estimate) - truth) ** 2, axis=1))))


def stretch_lengths(path_m: float) -> tuple[float, ...]:
    """Lengths of the subsequences for relative errors, m: KITTI's own from 300 m on, shorter ones for clips."""
    if path_m >= 3 * KITTI_LENGTHS_M[0]:
        return tuple(length for length in KITTI_LENGTHS_M if length <= path_m)
    return SHORT_LENGTHS_M if path_m >= 125.0 else TINY_LENGTHS_M


def relative_errors(T_estimate: FloatArray, T_truth: FloatArray, pairs: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Errors of the motions between pairs of frames: translation (M,) m and rotation angle (M,) rad.

    pairs : (M, 2) indices i, j. The error is (T_truth_i^-1 T_truth_j)^-1 (T_estimate_i^-1 T_estimate_j).
    """
    motion_truth = se3.inverse(T_truth[pairs[:, 0]]) @ T_truth[pairs[:, 1]]
    motion_estimate = se3.inverse(T_estimate[pairs[:, 0]]) @ T_estimate[pairs[:, 1]]
    error = se3.inverse(motion_truth) @ motion_estimate
    return np.linalg.norm(error[:, :3, 3], axis=1), rotation_angles(error)


def rotation_angles(T: FloatArray) -> FloatArray:
    """T (N, 4, 4) to rotation angles (N,) rad; by atan2, so that tiny angles do not drown in the cosine's rounding."""
    R = T[:, :3, :3]
    twice_sine = np.linalg.norm(
        np.column_stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]]), axis=1
    )
    angles: FloatArray = np.arctan2(twice_sine, np.trace(R, axis1=1, axis2=2) - 1.0)
    return angles


def stretches(T_truth: FloatArray, length_m: float, every: int = 1) -> NDArray[np.int64]:
    """(M, 2) frames i, j such that j is the first frame at least length_m of true path after i; i every `every` frames."""
    steps = np.linalg.norm(np.diff(T_truth[:, :3, 3], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    first = np.arange(0, len(T_truth), every)
    last = np.searchsorted(travelled, travelled[first] + length_m)
    fits = last < len(T_truth)
    return np.column_stack([first[fits], last[fits]])


def kitti_errors(
    T_estimate: FloatArray, T_truth: FloatArray, lengths_m: Sequence[float] | None = None, every: int = 1
) -> tuple[float, float]:
    """t_rel in % and r_rel in degrees per 100 m, means over all stretches of all lengths; NaN where no stretch fits.

    lengths_m : default `stretch_lengths` of the true path. KITTI's own benchmark starts a stretch at every 10th frame; clips
    have too few frames for that, so every frame starts one unless `every` says otherwise.
    """
    lengths = stretch_lengths(path_length(T_truth[:, :3, 3])) if lengths_m is None else lengths_m
    translation, rotation = [], []
    for length in lengths:
        t, r = relative_errors(T_estimate, T_truth, stretches(T_truth, length, every))
        translation.append(t / length)
        rotation.append(r / length)
    shares, rates = np.concatenate(translation), np.concatenate(rotation)
    if not len(shares):
        return float("nan"), float("nan")
    return 100.0 * float(shares.mean()), 100.0 * float(np.degrees(rates.mean()))


def evaluate(T_estimate: FloatArray, T_truth: FloatArray) -> TrajectoryErrors:
    """All errors of T_estimate (N, 4, 4) against T_truth (N, 4, 4); frames whose truth is NaN are left out.

    Raises InputError where the two differ in length or fewer than three frames can be compared.
    """
    if len(T_estimate) != len(T_truth):
        raise InputError(
            f"{len(T_estimate)} poses cannot be compared with {len(T_truth)} of the truth", remedy="give one pose for every frame"
        )
    known = np.isfinite(T_truth).all(axis=(1, 2))
    if known.sum() < 3:
        raise InputError(f"the truth knows {int(known.sum())} poses", remedy="at least 3 are needed")
    estimate, truth = T_estimate[known], T_truth[known]
    steps = np.column_stack([np.arange(len(truth) - 1), np.arange(1, len(truth))])
    translation, rotation = relative_errors(estimate, truth, steps)
    t_rel, r_rel = kitti_errors(estimate, truth)
    length_estimate, length_truth = path_length(estimate[:, :3, 3]), path_length(truth[:, :3, 3])
    return TrajectoryErrors(
        frames=len(truth),
        truth_m=length_truth,
        estimate_m=length_estimate,
        length_ratio=length_estimate / length_truth if length_truth > 0 else float("nan"),
        ate_m=ate_rmse(estimate, truth),
        t_rel_percent=t_rel,
        r_rel_deg_per_100m=r_rel,
        frame_translation_m=float(np.sqrt(np.mean(translation**2))),
        frame_rotation_deg=float(np.degrees(np.sqrt(np.mean(rotation**2)))),
    )
