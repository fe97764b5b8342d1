"""Inertial factors of the window: preintegration between keyframes, initialisation, and prediction of poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.types import ImuTrack
from wayloom.odometry.kernels.arrays import PATCH
from wayloom.odometry.kernels.inertial import STANDARD_GRAVITY, Inertial, inverse_covariance
from wayloom.odometry.kernels.preintegration import log_so3, predict, preintegrate
from wayloom.odometry.settings import ImuSettings

FloatArray = NDArray[np.float64]
GREY_SIGMA = 1.0
"""grey levels of a pixel that count as much as one sigma of the IMU; docs/odometry.md says why it is less than pixels fit to."""
OWN = 9
"""Inertial unknowns of a keyframe: velocity, gyroscope bias, accelerometer bias."""
DISCRETISATION = np.array([1e-6, 1e-5, 1e-5])
"""rad, m/s and m: what the midpoint rule may miss in a link, so that ideal samples do not count as infinitely good."""


def _no_imu() -> Inertial:
    none = np.zeros((0, 3))
    return Inertial(
        none, none, np.zeros((0, 6)), np.zeros((0, 6)), np.zeros(2), np.eye(3), np.eye(4), np.zeros(0, np.int64), np.zeros(0),
        np.zeros((0, 3, 3)), none, none, np.zeros((0, 9, 6)), np.zeros((0, 9, 9)), np.zeros((0, 6)), np.zeros(2), 0.0,
    )  # fmt: skip


NO_IMU: Final = _no_imu()


def is_inertial(inertial: Inertial) -> bool:
    """Whether the IMU is in use."""
    return len(inertial.velocity) > 0


def inertial_rows(F: int, j: int) -> NDArray[np.int64]:
    """(9,) where the inertial unknowns of keyframe j stand in a state of F keyframes."""
    return np.arange(1 + 8 * F + OWN * j, 1 + 8 * F + OWN * (j + 1))


@dataclass(frozen=True, slots=True)
class Link:
    """A preintegrated motion: duration s, R (3, 3), v, p (3,), J (9, 6) by the biases, covariance (9, 9), at bias (6,)."""

    duration: float
    R: FloatArray
    v: FloatArray
    p: FloatArray
    J: FloatArray
    covariance: FloatArray
    bias: FloatArray


class ImuSamples:
    """The samples of a drive on the camera's clock, in seconds since its first frame."""

    def __init__(self, track: ImuTrack, T_cam_imu: FloatArray, first_ns: int, settings: ImuSettings) -> None:
        self.t = (track.t_ns - first_ns) * 1e-9 - settings.time_offset_s
        self.force, self.rate = np.ascontiguousarray(track.specific_force), np.ascontiguousarray(track.angular_rate)
        self.T_cam_imu, self.first_ns, self.settings = np.ascontiguousarray(T_cam_imu, np.float64), first_ns, settings
        self.density = np.array([settings.gyroscope_noise, settings.accelerometer_noise])

    def link(self, start_ns: int, stop_ns: int, bias: FloatArray) -> Link | None:
        """The motion between two moments at a bias (6,); None where samples are missing for longer than `max_gap_s`."""
        start, stop = ((t - self.first_ns) * 1e-9 for t in (start_ns, stop_ns))
        first, last = np.searchsorted(self.t, start, "right") - 1, np.searchsorted(self.t, stop, "left")
        if first < 0 or last >= len(self.t) or np.diff(self.t[first : last + 1]).max(initial=0.0) > self.settings.max_gap_s:
            return None
        R, v, p, J, C = np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros((9, 6)), np.zeros((9, 9))
        preintegrate(self.t, self.force, self.rate, start, stop, bias, self.density, R, v, p, J, C)
        C += np.diag(np.repeat(DISCRETISATION**2, 3))
        return Link(stop - start, R, v, p, J, C, bias.copy())


@dataclass(frozen=True, slots=True)
class Start:
    """Where the inertial state starts from: gravity (3,) m/s^2 in the world, velocities (F, 3) m/s, the gyroscope's bias (3,) rad/s
    beyond that of the links."""

    gravity: FloatArray
    velocity: FloatArray
    gyroscope_bias: FloatArray


def find_start(T_world_imu: FloatArray, links: Sequence[Link], settings: ImuSettings) -> Start | None:
    """Gravity, velocities and gyroscope bias from F poses (F, 4, 4) and the F - 1 links between them; None while they do not tell.

    The bias first, from rotations alone; then p_j - p_i = v_i t + g t^2 / 2 + R_i p_ij and v_j - v_i = g t + R_i v_ij are linear
    in what is left. The length of g, which nothing imposes, tells whether the answer can be trusted.
    """
    bias = _gyroscope_bias(T_world_imu, links)
    F = len(T_world_imu)
    A, b = np.zeros((6 * (F - 1), 3 * F + 3)), np.zeros(6 * (F - 1))
    eye = np.eye(3)
    for k, link in enumerate(links):
        R, t, d = T_world_imu[k, :3, :3], link.duration, link.J[:, :3] @ bias
        rows = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
        A[rows[0], 3 * k : 3 * k + 3], A[rows[0], -3:] = t * eye, 0.5 * t**2 * eye
        b[rows[0]] = T_world_imu[k + 1, :3, 3] - T_world_imu[k, :3, 3] - R @ (link.p + d[6:])
        A[rows[1], 3 * k : 3 * k + 3], A[rows[1], 3 * k + 3 : 3 * k + 6], A[rows[1], -3:] = -eye, eye, -t * eye
        b[rows[1]] = R @ (link.v + d[3:6])
    x, *_ = np.linalg.lstsq(A, b, rcond=None)
    length = float(np.linalg.norm(x[-3:]))
    if not abs(length - STANDARD_GRAVITY) < settings.start_gravity_m_s2:
        return None
    gravity, velocity = np.asarray(x[-3:] / length * STANDARD_GRAVITY, np.float64), np.asarray(x[:-3].reshape(F, 3), np.float64)
    return Start(gravity, velocity, bias)


def _gyroscope_bias(T_world_imu: FloatArray, links: Sequence[Link]) -> FloatArray:
    """(3,) rad/s that brings the gyroscope's rotations onto those of the poses: least squares, one step (rotations are small)."""
    H, g = 1e-9 * np.eye(3), np.zeros(3)
    for k, link in enumerate(links):
        seen = T_world_imu[k, :3, :3].T @ T_world_imu[k + 1, :3, :3]
        J = link.J[:3, :3]
        H += J.T @ J
        g += J.T @ log_so3(np.ascontiguousarray(link.R.T @ seen))
    return np.asarray(np.linalg.solve(H, g), np.float64)


def begin(start: Start, bias: FloatArray, links: Sequence[Link | None], T_cam_imu: FloatArray, settings: ImuSettings) -> Inertial:
    """The inertial state of F keyframes at its start. bias (6,) of the links (F - 1); the gyroscope's from `start` is added."""
    F, n = len(start.velocity), start.gravity / np.linalg.norm(start.gravity)
    side = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
    side /= np.linalg.norm(side)
    walk = 1.0 / np.array([settings.gyroscope_walk, settings.accelerometer_walk]) ** 2
    out = NO_IMU._replace(
        basis=np.column_stack([n, side, np.cross(n, side)]), gamma=np.zeros(2), T_cam_imu=T_cam_imu, walk=walk,
        weight=PATCH * GREY_SIGMA**2,
    )  # fmt: skip
    bias = bias + np.concatenate([start.gyroscope_bias, np.zeros(3)])
    for f in range(F):
        out = with_keyframe(out, start.velocity[f], bias, None if f == 0 else links[f - 1])
    return out


def with_keyframe(inertial: Inertial, velocity: FloatArray, bias: FloatArray, link: Link | None) -> Inertial:
    """One more keyframe at the end, and the link that leads to it."""
    F = len(inertial.velocity)
    out = inertial._replace(
        velocity=_longer(inertial.velocity, velocity), velocity_first=_longer(inertial.velocity_first, velocity),
        bias=_longer(inertial.bias, bias), bias_first=_longer(inertial.bias_first, bias),
        has_link=np.append(inertial.has_link, 0), duration=np.append(inertial.duration, 0.0),
        R=_longer(inertial.R, np.eye(3)), v=_longer(inertial.v, np.zeros(3)), p=_longer(inertial.p, np.zeros(3)),
        J=_longer(inertial.J, np.zeros((9, 6))), information=_longer(inertial.information, np.zeros((9, 9))),
        bias_at=_longer(inertial.bias_at, bias),
    )  # fmt: skip
    if F and link is not None:
        out.has_link[F - 1], out.duration[F - 1], out.bias_at[F - 1] = 1, link.duration, link.bias
        out.R[F - 1], out.v[F - 1], out.p[F - 1], out.J[F - 1] = link.R, link.v, link.p, link.J
        out.information[F - 1] = inverse_covariance(link.covariance)
    return out


def _longer(column: FloatArray, row: FloatArray) -> FloatArray:
    return np.concatenate([column, row[None]])


def without_keyframe(inertial: Inertial, j: int) -> Inertial:
    """The inertial state after keyframe j has left; its links must have been folded into the prior."""
    of_drive = ("gamma", "basis", "T_cam_imu", "walk", "weight")
    columns = {name: np.delete(column, j, axis=0) for name, column in inertial._asdict().items() if name not in of_drive}
    return inertial._replace(**columns)


def predicted_pose(
    samples: ImuSamples,
    T_world_cam: tuple[FloatArray, FloatArray],
    t_ns: tuple[int, int, int],
    gravity: FloatArray,
    bias: FloatArray,
) -> FloatArray | None:
    """T_world_cam (4, 4) at the last of three moments, from the poses at the first two; None where samples are missing.

    The velocity at the second follows from the way between the two and what the accelerometer felt there.
    """
    first, second = (samples.link(t_ns[k], t_ns[k + 1], bias) for k in (0, 1))
    if first is None or second is None:
        return None
    a, b = (T @ samples.T_cam_imu for T in T_world_cam)
    R, t = a[:3, :3], first.duration
    velocity = (b[:3, 3] - a[:3, 3] - 0.5 * gravity * t**2 - R @ first.p) / t + gravity * t + R @ first.v
    T, _ = predict(np.ascontiguousarray(b), velocity, gravity, second.duration, second.R, second.v, second.p)
    return np.asarray(T @ se3.inverse(samples.T_cam_imu))
