"""Visual-inertial fusion in the window: start from gravity, preintegrated links of new keyframes, predicted poses.

docs/odometry-design.md has the equations.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.types import DriveLog
from wayloom.odometry.backend import inertial
from wayloom.odometry.backend.inertial import ImuSamples
from wayloom.odometry.backend.window import Window, with_rows
from wayloom.odometry.kernels.inertial import gravity as gravity_of
from wayloom.odometry.settings import OdometrySettings

FloatArray = NDArray[np.float64]


class VisualInertial:
    """The IMU beside a window. It starts once the window has a prior and its poses tell gravity; what it learns stays."""

    def __init__(self, samples: ImuSamples) -> None:
        self.samples = samples
        self.gravity: FloatArray | None = None
        self.bias = np.zeros(6)
        self._started_ns: list[int] = []

    def predicted_pose(self, T_world_cam: tuple[FloatArray, FloatArray], t_ns: tuple[int, int, int]) -> FloatArray | None:
        """T_world_cam (4, 4) at the last of three moments from the poses at the first two; None while gravity is unknown."""
        if self.gravity is None:
            return None
        return inertial.predicted_pose(self.samples, T_world_cam, t_ns, self.gravity, self.bias)

    def extend(self, window: Window, t_ns: Sequence[int]) -> None:
        """Link the window's newest keyframe, just added, with the one before. t_ns: of the window's keyframes."""
        state = window.inertial
        if not inertial.is_inertial(state):
            return
        before = len(window) - 2
        link = self.samples.link(t_ns[-2], t_ns[-1], state.bias[before])
        velocity = state.velocity[before]
        if link is not None and self.gravity is not None:
            R = se3.inverse(window.frames.T_cam_world[before])[:3, :3] @ self.samples.T_cam_imu[:3, :3]
            velocity = velocity + self.gravity * link.duration + R @ link.v
        window.inertial = inertial.with_keyframe(state, velocity, state.bias[before], link)
        at = 1 + 8 * len(window) + inertial.OWN * (before + 1)
        window.prior_H, window.prior_g = with_rows(window.prior_H, window.prior_g, at, inertial.OWN)

    def learn(self, window: Window, t_ns: Sequence[int]) -> None:
        """After an adjustment: take what the window knows of gravity and biases, or start the IMU if it can be started."""
        if inertial.is_inertial(window.inertial):
            self.gravity = gravity_of(window.inertial.gamma, window.inertial.basis, np.zeros((3, 2)))
            self.bias = window.inertial.bias[-1].copy()
        elif window.has_prior and bool(window.frames.has_first.all()):
            self._start(window, t_ns)

    def _start(self, window: Window, t_ns: Sequence[int]) -> None:
        settings, F = self.samples.settings, len(window)
        links = [self.samples.link(a, b, self.bias) for a, b in pairwise(t_ns)]
        whole = [link for link in links if link is not None]
        if len(whole) < F - 1 or sum(link.duration for link in whole) < settings.start_span_s:
            return
        T_world_imu = se3.inverse(window.frames.T_cam_world) @ self.samples.T_cam_imu
        start = inertial.find_start(T_world_imu, whole, settings)
        if start is None:
            return
        window.inertial = inertial.begin(start, self.bias, links, self.samples.T_cam_imu, settings)
        window.prior_H = np.pad(window.prior_H, (0, inertial.OWN * F + 2))
        window.prior_g = np.pad(window.prior_g, (0, inertial.OWN * F + 2))
        first = inertial.inertial_rows(F, 0)[3:]
        sigma = np.repeat([settings.gyroscope_bias, settings.accelerometer_bias], 3)
        window.prior_H[first, first] += window.inertial.weight / sigma**2
        self.gravity, self.bias = start.gravity, window.inertial.bias[-1].copy()
        self._started_ns.append(int(t_ns[-1]))

    def report(self) -> dict[str, Any]:
        """JSON-ready facts."""
        return {
            "started_s": [round(t * 1e-9 - self.samples.first_ns * 1e-9, 3) for t in self._started_ns],
            "gravity_world_m_s2": None if self.gravity is None else [float(g) for g in self.gravity],
            "gyroscope_bias_rad_s": [float(b) for b in self.bias[:3]],
            "accelerometer_bias_m_s2": [float(b) for b in self.bias[3:]],
        }


def for_log(log: DriveLog, settings: OdometrySettings) -> VisualInertial | None:
    """The IMU of a log where it has one and the settings let it be used."""
    if log.imu is None or log.T_cam_imu is None or not settings.imu.use or not len(log.imu.t_ns):
        return None
    return VisualInertial(ImuSamples(log.imu, log.T_cam_imu, int(log.t_ns[0]), settings.imu))
