"""Witnesses of up along a drive: accelerometer, uprights and street, each with a lean of its own, as terms of the drive's graph."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayloom.georeference.gravity.accelerometer import up_by_accelerometer
from wayloom.georeference.gravity.sections import Section, sections
from wayloom.georeference.gravity.street import lean_by_street
from wayloom.georeference.gravity.uprights import Lean, lean_by_uprights, scatter_ratio
from wayloom.georeference.nodes import nearest_node
from wayloom.georeference.scale_prior import scale_prior
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.labelling.types import PointLabels
from wayloom.logs.types import DriveLog
from wayloom.mapping.up_factors import ROLL_PITCH, UpObservations
from wayloom.odometry.types import OdometryResult, Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
WITNESSES: Final = ("accelerometer", "uprights", "street")
SECTION_M, STREET_EVERY_M = 25.0, 100.0
Observation = tuple[int, FloatArray, FloatArray, int]
"""Frame, up in its camera (3,), covariance (2, 2), row of WITNESSES."""


@dataclass(frozen=True, slots=True)
class SeenUp:
    """N observations of up by WITNESSES in the cameras of a drive's frames.

    frame (N,), up_cam (N, 3) unit vectors, covariance (N, 2, 2) rad^2 of their x and z components, witness (N,) row of WITNESSES
    """

    frame: IntArray
    up_cam: FloatArray
    covariance: FloatArray
    witness: IntArray

    def at_nodes(self, trajectory: Trajectory, nodes: IntArray, settings: GeoReferenceSettings) -> UpObservations:
        """The same at a drive's nodes (K,) frames, each at the nearest, by witnesses that lean as far as the settings have it."""
        node, turn = _nearest(trajectory, nodes, self.frame)
        up_node = np.einsum("nij,nj->ni", turn, self.up_cam)
        lean_deg = [[settings.accelerometer_lean_deg] * 2, [settings.uprights_lean_deg, settings.uprights_pitch_deg]]
        lean_deg.append([settings.street_lean_deg] * 2)
        return UpObservations(node, up_node, self.covariance, self.witness, np.radians(np.array(lean_deg)))


def seen_up(log: DriveLog, odometry: OdometryResult, labels: PointLabels | None, settings: GeoReferenceSettings) -> SeenUp:
    """What sensors and surroundings say of up. Without labels of the odometry's points the accelerometer alone speaks."""
    found = list(_of_accelerometer(log, odometry, settings))
    if labels is not None and len(labels) == len(odometry.points):
        found += _of_surroundings(odometry, labels.stereo)
    return SeenUp(
        frame=np.array([row[0] for row in found], np.int64),
        up_cam=np.array([row[1] for row in found]).reshape(-1, 3),
        covariance=np.array([row[2] for row in found]).reshape(-1, 2, 2),
        witness=np.array([row[3] for row in found], np.int64),
    )


def witnesses_report(up: UpObservations) -> dict[str, int]:
    """JSON-ready: how often each witness spoke."""
    return {name: int((up.witness == row).sum()) for row, name in enumerate(WITNESSES)}


def _of_accelerometer(log: DriveLog, odometry: OdometryResult, settings: GeoReferenceSettings) -> Iterator[Observation]:
    if log.imu is None or log.T_cam_imu is None:
        return
    position_m = settings.standing_position_m + settings.position_noise_m
    scale_sigma = scale_prior(odometry.report, settings)
    windows = up_by_accelerometer(log.imu, log.T_cam_imu, odometry.trajectory, scale_sigma, settings.scale_length_m, position_m)
    floor2 = np.radians(settings.accelerometer_floor_deg) ** 2
    for frame, up, covariance in zip(windows.frame.tolist(), windows.up_cam, windows.covariance, strict=True):
        yield frame, up, covariance[np.ix_(ROLL_PITCH, ROLL_PITCH)] + floor2 * np.eye(2), 0


def _of_surroundings(odometry: OdometryResult, label: NDArray[np.uint8]) -> Iterator[Observation]:
    told = [_told(odometry, section) for section in sections(odometry, label, SECTION_M)]
    ratio = scatter_ratio([one.uprights for one in told if one.uprights is not None])
    for one in told:
        if one.uprights is not None:
            yield one.frame, *_in_camera(one.T_level_cam, one.uprights, ratio**2), 1
    for one in told:
        if one.street is not None:
            yield one.frame, *_in_camera(one.T_level_cam, one.street, STREET_EVERY_M / SECTION_M), 2


class _Told(NamedTuple):
    """What a section's points have said, by which they need not be kept."""

    frame: int
    T_level_cam: FloatArray
    uprights: Lean | None
    street: Lean | None


def _told(odometry: OdometryResult, section: Section) -> _Told:
    frame = int(odometry.keyframes.frame[section.keyframe])
    return _Told(frame, section.T_level_cam, lean_by_uprights(section), lean_by_street(section))


def _in_camera(T_level_cam: FloatArray, lean: Lean, times: float) -> tuple[FloatArray, FloatArray]:
    """Up in the camera's frame, and the covariance of its x and z components, so many times as large."""
    up = np.array([*lean.right_ahead, 1.0])
    turn = T_level_cam[:2][:, ROLL_PITCH]
    up_cam = T_level_cam[:3, :3].T @ (up / np.linalg.norm(up))
    return up_cam, times * turn.T @ lean.covariance @ turn


def _nearest(trajectory: Trajectory, nodes: IntArray, frames: IntArray) -> tuple[IntArray, FloatArray]:
    """(n,) row of the node nearest to each frame, and (n, 3, 3) the rotation to its camera."""
    if not len(frames):
        return np.zeros(0, np.int64), np.zeros((0, 3, 3))
    node = nearest_node(nodes, trajectory.segment, frames)
    R_world_node, R_world_cam = (trajectory.T_world_cam[rows, :3, :3] for rows in (nodes[node], frames))
    return node, np.swapaxes(R_world_node, 1, 2) @ R_world_cam
