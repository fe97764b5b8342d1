"""First places of drives without GNSS: by the meetings that agree with each other most.

Each meeting with a drive that has a place proposes one for the whole drive. Two proposals agree where they differ by no more than
the covariances of both meetings, both places met and the drive's own way between allow. The proposal that most others agree with
wins, the surest of equals. Drives are placed one after another, those with the most agreeing proposals first, and then help others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.loop_votes import mahalanobis2
from wayloom.stitching.drive_chain import joined
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import AlignedDrive, DrivePlaces, Meeting

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
FAR2 = 1e6
"""Variance across a loss of the track, m^2 and rad^2."""
LOOK_ALIKE_M = 10.0
"""Proposals that differ by less are one place, badly measured: less than a street and the next one that looks like it."""


@dataclass(frozen=True, slots=True)
class Joined:
    """A drive with a place in the map.

    covariance (n, 6, 6) of its submaps' left perturbations by all that is known before meetings are joined; where it has no GNSS,
    by the one meeting that placed it
    """

    drive: DrivePlaces
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Places:
    """What each of P views proposes: here (P, 4, 4) of its own submap, T_map_own (P, 4, 4) of the drive's frame, total (P, 6, 6) of
    the left perturbation of here; agree (P, P) whether two propose one place."""

    here: FloatArray
    T_map_own: FloatArray
    total: FloatArray
    row: IntArray
    agree: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Proposal:
    """votes: meetings that agree, this one among them; level T_map_own (4, 4); covariance as in `Joined`."""

    votes: int
    T_map_own: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class View:
    """A meeting seen from a drive: with which submap of which other, by which of its own; T_other_own (4, 4), covariance (6, 6)."""

    other: str
    submap: int
    own: int
    T_other_own: FloatArray
    covariance: FloatArray


def join_drives(drives: Sequence[DrivePlaces], meetings: Sequence[Meeting], settings: CityGraphSettings) -> dict[str, Joined]:
    """By id: located drives as they are, others where their meetings put them; those whose meetings do not agree are left out.

    A function of the sets: the order of drives and meetings makes no difference.
    """
    by_id = {drive.drive_id: drive for drive in sorted(drives, key=lambda drive: drive.drive_id)}
    placed = {name: Joined(drive, drive.covariance) for name, drive in by_id.items() if drive.located}
    seen = _seen_from({name for name in by_id if name not in placed}, meetings)
    found = {name: _proposed(by_id[name], placed, views, settings) for name, views in seen.items()}
    while found:
        name = max(found, key=lambda one: found[one].votes)  # the first of equals
        best = found.pop(name)
        if best.votes < settings.least_agreeing:
            break
        placed[name] = Joined(joined(by_id[name], best.T_map_own, settings), best.covariance)
        for other in found:
            if any(view.other == name for view in seen[other]):
                found[other] = _proposed(by_id[other], placed, seen[other], settings)
    return dict(sorted(placed.items()))


def rivals(
    drive: DrivePlaces, aligned: Mapping[str, AlignedDrive], meetings: Sequence[Meeting], settings: CityGraphSettings
) -> str:
    """How a drive without GNSS fits the others at places that lie apart, in words; empty where it does not.

    aligned : the others, where the city graph has them
    meetings : of the drive with others
    A single meeting that puts the drive elsewhere counts: streets that look alike fit as well as the true one does.
    """
    views = _seen_from({drive.drive_id}, meetings)[drive.drive_id]
    views = [view for view in views if view.other in aligned and aligned[view.other].placed]
    if len(views) < 2:
        return ""
    found = _places({name: (one.T_map_submap, one.covariance) for name, one in aligned.items()}, drive, views, settings)
    best = _surest(found)
    middle = found.T_map_own @ drive.T_map_submap[len(drive) // 2, :, 3]
    apart = np.linalg.norm((middle - middle[best])[:, :3], axis=1)
    apart[found.agree[best]] = 0.0
    rival = int(np.argmax(apart))
    if apart[rival] <= LOOK_ALIKE_M:
        return ""
    one, other = (f"drive {views[row].other[:12]}" for row in (best, rival))
    where = f"{one} at two places" if one == other else f"{one} and {other} at places"
    return f"it fits {where} {apart[rival]:.0f} m apart: streets look alike"


def _seen_from(loose: set[str], meetings: Sequence[Meeting]) -> dict[str, list[View]]:
    """The views of each of the drives, drives and views in canonical order."""
    out: dict[str, list[View]] = {name: [] for name in sorted(loose)}
    for one in meetings:
        if one.drive_b in loose:
            out[one.drive_b].append(View(one.drive_a, one.submap_a, one.submap_b, one.T_a_b, one.covariance))
        if one.drive_a in loose:
            back = se3.inverse(one.T_a_b)
            out[one.drive_a].append(View(one.drive_b, one.submap_b, one.submap_a, back, _moved(back, one.covariance)))
    for views in out.values():
        views.sort(key=lambda view: (view.other, view.submap, view.own, view.T_other_own.tobytes()))
    return out


def _proposed(drive: DrivePlaces, placed: dict[str, Joined], views: Sequence[View], settings: CityGraphSettings) -> Proposal:
    """The best proposal; one without votes where no meeting is with a drive that has a place."""
    views = [view for view in views if view.other in placed]
    if not views:
        return Proposal(0, np.eye(4), drive.covariance)
    found = _places({name: (one.drive.T_map_submap, one.covariance) for name, one in placed.items()}, drive, views, settings)
    best = _surest(found)
    k = int(found.row[best])
    T_level = _level(found.T_map_own[best], drive.T_map_submap[k, :3, 3], found.here[best, :3, 3])
    places = (T_level @ drive.T_map_submap)[:, :3, 3]
    drift = _moved(_shift(0.5 * (places + places[k])), _drift(drive, np.full(len(drive), k), np.arange(len(drive)), settings))
    return Proposal(int(found.agree[best].sum()), T_level, found.total[best] + drift)


def _places(
    known: Mapping[str, tuple[FloatArray, FloatArray]], drive: DrivePlaces, views: Sequence[View], settings: CityGraphSettings
) -> Places:
    """What the views propose; known: T_map_submap and covariance of each other drive's submaps."""
    at = np.array([known[view.other][0][view.submap] for view in views])
    sure = np.array([known[view.other][1][view.submap] for view in views])
    row = np.array([view.own for view in views])
    here = at @ np.array([view.T_other_own for view in views])
    T_map_own = here @ se3.inverse(drive.T_map_submap[row])
    total = sure + _moved(at, np.array([view.covariance for view in views]))  # of the left perturbation in the map's frame
    agree = _differences(here, T_map_own, total, row, drive, settings) <= float(chi_square_quantile(settings.confidence, 6))
    return Places(here, T_map_own, total, row, agree | np.eye(len(row), dtype=np.bool_))


def _surest(found: Places) -> int:
    """The proposal that most agree with, the surest of equals."""
    spread = np.trace(_moved(_shift(-found.here[:, :3, 3]), found.total)[:, :3, :3], axis1=1, axis2=2)
    return int(np.lexsort((spread, -found.agree.sum(axis=1)))[0])


def _differences(
    here: FloatArray,
    T_map_own: FloatArray,
    total: FloatArray,
    row: IntArray,
    drive: DrivePlaces,
    settings: CityGraphSettings,
) -> FloatArray:
    """(P, P) chi-square of the difference of each two of P proposals, about the middle of their submaps."""
    P = len(row)
    i, j = np.divmod(np.arange(P * P), P)
    middle = _shift(-0.5 * (here[i] + here[j])[:, :3, 3])
    off = middle @ T_map_own[i] @ se3.inverse(T_map_own[j]) @ se3.inverse(middle)
    spread = _moved(middle, total[i] + total[j]) + _drift(drive, row[i], row[j], settings)
    return mahalanobis2(off, spread, False).reshape(P, P)


def _drift(drive: DrivePlaces, first: IntArray, second: IntArray, settings: CityGraphSettings) -> FloatArray:
    """(P, 6, 6) by which the odometry may err between submaps first and second (P,), about the middle between them."""
    end = np.cumsum(drive.length_m)
    road = np.abs(end[second] - end[first])
    turn2 = np.radians(settings.rotation_noise_deg) ** 2 * road
    position2 = settings.position_noise_m**2 * road + turn2 * road**2 / 12.0 + (settings.scale_sigma * road) ** 2
    lost = np.concatenate([[0], np.cumsum(~drive.connected)])
    free = FAR2 * (lost[second] != lost[first])
    return np.asarray((np.repeat(np.stack([position2, turn2], axis=1), 3, axis=1) + free[:, None])[:, :, None] * np.eye(6))


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
