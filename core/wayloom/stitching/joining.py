"""First places of drives without GNSS: by the meetings that agree with each other most.

Each meeting with a drive that has a place proposes one for the whole drive. Two proposals agree where they differ by no more than
the covariances of both meetings, both places met and the drive's own way between allow. The proposal that most others agree with
wins, the surest of equals. Drives are placed one after another, those with the most agreeing proposals first, and then help others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi_square

from wayloom.geometry import se3
from wayloom.mapping.loop_votes import mahalanobis2
from wayloom.stitching.drive_chain import joined
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import DrivePlaces, Meeting

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
FAR2 = 1e6
"""Variance across a loss of the track, m^2 and rad^2."""


@dataclass(frozen=True, slots=True)
class Joined:
    """A drive with a place in the map.

    covariance (n, 6, 6) of its submaps' left perturbations by all that is known before meetings are joined; where it has no GNSS,
    by the one meeting that placed it
    """

    drive: DrivePlaces
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Proposal:
    """votes: meetings that agree, this one among them; level T_map_own (4, 4); covariance as in `Joined`."""

    votes: int
    T_map_own: FloatArray
    covariance: FloatArray


def join_drives(drives: Sequence[DrivePlaces], meetings: Sequence[Meeting], settings: CityGraphSettings) -> dict[str, Joined]:
    """By id: located drives as they are, others where their meetings put them; those whose meetings do not agree are left out.

    A function of the sets: the order of drives and meetings makes no difference.
    """
    by_id = {drive.drive_id: drive for drive in sorted(drives, key=lambda drive: drive.drive_id)}
    placed = {name: Joined(drive, drive.covariance) for name, drive in by_id.items() if drive.located}
    loose = [name for name in by_id if name not in placed]
    while loose:
        found = {name: _proposed(by_id[name], placed, meetings, settings) for name in loose}
        name = max(loose, key=lambda one: found[one].votes)  # the first of equals
        best = found[name]
        if best.votes < settings.least_agreeing:
            break
        placed[name] = Joined(joined(by_id[name], best.T_map_own, settings), best.covariance)
        loose.remove(name)
    return placed


def _proposed(drive: DrivePlaces, placed: dict[str, Joined], meetings: Sequence[Meeting], settings: CityGraphSettings) -> Proposal:
    """The best proposal; one without votes where no meeting is with a drive that has a place."""
    own = sorted(
        (one for one in (_seen_from(meeting, drive.drive_id) for meeting in meetings) if one is not None and one[0] in placed),
        key=lambda one: (one[0], one[1], one[2], one[3].tobytes()),
    )
    if not own:
        return Proposal(0, np.eye(4), drive.covariance)
    at = np.array([placed[other].drive.T_map_submap[k] for other, k, _, _, _ in own])
    known = np.array([placed[other].covariance[k] for other, k, _, _, _ in own])
    Z, C = np.array([one[3] for one in own]), np.array([one[4] for one in own])
    row = np.array([one[2] for one in own])
    here = at @ Z
    T_map_own = here @ se3.inverse(drive.T_map_submap[row])
    total = known + _moved(at, C)  # of the left perturbation in the map's frame
    c2 = float(chi_square.ppf(settings.confidence, 6))
    votes = np.array([(_differences(k, here, T_map_own, total, row, drive, settings) <= c2).sum() for k in range(len(own))])
    spread = np.trace(_moved(_shift(-here[:, :3, 3]), total)[:, :3, :3], axis1=1, axis2=2)
    best = int(np.lexsort((spread, -votes))[0])
    T_level = _level(T_map_own[best], drive.T_map_submap[row[best], :3, 3], here[best, :3, 3])
    k = int(row[best])
    places = (T_level @ drive.T_map_submap)[:, :3, 3]
    drift = _moved(_shift(0.5 * (places + places[k])), _drift(drive, k, np.arange(len(drive)), settings))
    return Proposal(int(votes[best]), T_level, total[best] + drift)


def _differences(
    k: int,
    here: FloatArray,
    T_map_own: FloatArray,
    total: FloatArray,
    row: IntArray,
    drive: DrivePlaces,
    settings: CityGraphSettings,
) -> FloatArray:
    """(P,) chi-square of the difference of each proposal from the k-th, about the middle of their submaps."""
    middle = _shift(-0.5 * (here + here[k])[:, :3, 3])
    off = middle @ T_map_own @ se3.inverse(T_map_own[k]) @ se3.inverse(middle)
    both = total + np.where(np.arange(len(row)) == k, 0.0, 1.0)[:, None, None] * total[k]
    return mahalanobis2(off, _moved(middle, both) + _drift(drive, int(row[k]), row, settings), False)


def _drift(drive: DrivePlaces, k: int, rows: IntArray, settings: CityGraphSettings) -> FloatArray:
    """(P, 6, 6) by which the odometry may err between submap k and others (P,), about the middle between them."""
    end = np.cumsum(drive.length_m)
    road = np.abs(end[rows] - end[k])
    turn2 = np.radians(settings.rotation_noise_deg) ** 2 * road
    position2 = settings.position_noise_m**2 * road + turn2 * road**2 / 12.0 + (settings.scale_sigma * road) ** 2
    lost = np.concatenate([[0], np.cumsum(~drive.connected)])
    free = FAR2 * (lost[rows] != lost[k])
    return np.asarray((np.repeat(np.stack([position2, turn2], axis=1), 3, axis=1) + free[:, None])[:, :, None] * np.eye(6))


def _seen_from(meeting: Meeting, drive_id: str) -> tuple[str, int, int, FloatArray, FloatArray] | None:
    """The other drive, its submap, the drive's submap, T_other_own and its left covariance; None where it is not of this drive."""
    if meeting.drive_b == drive_id:
        return meeting.drive_a, meeting.submap_a, meeting.submap_b, meeting.T_a_b, meeting.covariance
    if meeting.drive_a == drive_id:
        back = se3.inverse(meeting.T_a_b)
        return meeting.drive_b, meeting.submap_b, meeting.submap_a, back, _moved(back, meeting.covariance)
    return None


def _level(T_map_own: FloatArray, p_own: FloatArray, p_map: FloatArray) -> FloatArray:
    """The turn about up nearest to T_map_own (4, 4) that takes p_own (3,) to p_map (3,): both frames are level."""
    R = T_map_own[:3, :3]
    yaw = np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return se3.from_rotation_translation(turn, p_map - turn @ p_own)


def _shift(t: FloatArray) -> FloatArray:
    return se3.from_rotation_translation(np.broadcast_to(np.eye(3), (*t.shape, 3)), t)


def _moved(T: FloatArray, covariance: FloatArray) -> FloatArray:
    Ad = se3.adjoint(T)
    return np.asarray(Ad @ covariance @ np.swapaxes(Ad, -1, -2))
