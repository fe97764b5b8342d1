"""Submap extraction: a labelled drive cut into submaps, with point selection by depth uncertainty."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PERSONS, SKY
from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.georeference.nodes import travelled
from wayloom.georeference.rigid import mean_motion
from wayloom.georeference.types import Anchors, GeoReference
from wayloom.labelling.types import PointLabels
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import POINTS_AT_ONCE, Keyframes, OdometryResult
from wayloom.submaps.bend import noticed, stretches2
from wayloom.submaps.settings import SubmapSettings
from wayloom.submaps.submap import PlacedSubmap, StepBefore, Submap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def make_submaps(
    log: DriveLog,
    odometry: OdometryResult,
    labels: PointLabels,
    geo: GeoReference,
    settings: SubmapSettings = SubmapSettings(),
    drive_id: str | None = None,
) -> Iterator[PlacedSubmap]:
    """The submaps of a drive in the order of the road, each made when it is asked for. Every point that is kept is in exactly one.

    drive_id : which drive the map shall name; None takes the log's name
    Raises StageError, with the first, when labels and points do not belong together.
    """
    if len(labels) != len(odometry.points):
        raise StageError(f"{len(labels)} labels for {len(odometry.points)} points: labelling and odometry are of different runs")
    verdict, hosted = _judge_points(odometry, labels, settings), HostedPoints.of(odometry)
    stretches = split_road(odometry, settings)
    anchors = anchor_frames(odometry, stretches)
    told = zip(anchors.tolist(), (None, *_steps(geo.anchors, anchors)), stretches2(geo, anchors).tolist(), strict=True)
    for stretch, (anchor, step, stretch2) in zip(stretches, told, strict=True):
        submap = _submap(odometry, labels, verdict, hosted.rows(stretch), stretch, settings)
        yield _place(submap, geo, anchor, drive_id or log.name, step, stretch2)


@dataclass(frozen=True, slots=True)
class Stretch:
    """Section of road of one submap: keyframes (K,) rows, each the one before plus one; anchor the row in the middle of the road;
    length_m of road."""

    keyframes: IntArray
    anchor: int
    length_m: float


@dataclass(frozen=True, slots=True)
class HostedPoints:
    """Points by their hosts: order (P,) rows of the points, start (K + 1,) where in it those of each keyframe begin."""

    order: IntArray
    start: IntArray

    @classmethod
    def of(cls, odometry: OdometryResult) -> "HostedPoints":
        """Those of a drive."""
        order = np.argsort(odometry.points.host, kind="stable")
        return cls(order, np.searchsorted(odometry.points.host[order], np.arange(len(odometry.keyframes) + 1)))

    def rows(self, stretch: Stretch) -> IntArray:
        """(n,) rows of the points that a section's keyframes host."""
        return self.order[self.start[stretch.keyframes[0]] : self.start[stretch.keyframes[-1] + 1]]


def split_road(odometry: OdometryResult, settings: SubmapSettings) -> list[Stretch]:
    """Cut every unbroken piece of the track into sections of equal length, as near to the wanted length as whole numbers allow."""
    road = travelled(odometry.trajectory)[odometry.keyframes.frame]
    stretches = []
    for rows in unbroken_pieces(odometry.keyframes, settings.broken_step_m):
        length = float(road[rows[-1]] - road[rows[0]])
        pieces = max(1, round(length / settings.length_m))
        pieces += length / pieces > settings.max_length_m
        piece = np.minimum(((road[rows] - road[rows[0]]) / max(length, 1e-9) * pieces).astype(np.int64), pieces - 1)
        for number in np.unique(piece):
            members = rows[piece == number]
            middle = 0.5 * (road[members[0]] + road[members[-1]])
            stretches.append(Stretch(members, int(members[np.argmin(np.abs(road[members] - middle))]), length / pieces))
    return stretches


def unbroken_pieces(keyframes: Keyframes, broken_step_m: float) -> list[IntArray]:
    """Rows of the keyframes, in order, in pieces that end with a segment and where steps are broken.

    A submap is rigid, so what lies on both sides of a step that may be off by more than a voxel's half belongs to two. Of broken
    steps in a row the keyframes in between are a piece of their own, as doubtful inside as they are; its neighbours are whole.

    broken_step_m : sigma of a step along its worst axis from which it is broken; unknown ones (NaN) are not
    """
    spread = np.nan_to_num(keyframes.step_covariance[:, :3, :3].astype(np.float64))
    broken = np.linalg.eigvalsh(spread)[:, -1] > broken_step_m**2
    first_of_run = broken & ~np.concatenate([[False], broken[:-1]])
    last_of_run = broken & ~np.concatenate([broken[1:], [False]])  # what follows it is whole again
    new_segment = np.diff(keyframes.segment, prepend=keyframes.segment[:1]) != 0
    return np.split(np.arange(len(broken)), np.flatnonzero(new_segment | first_of_run | last_of_run))


def anchor_frames(odometry: OdometryResult, stretches: list[Stretch]) -> IntArray:
    """(S,) frames of the log at which the sections' anchors stand."""
    return np.asarray(odometry.keyframes.frame[[stretch.anchor for stretch in stretches]], np.int64)


NAMES = ("kept", "without depth", "too far", "depth too uncertain", "sky", "persons")
KEPT, NO_DEPTH, TOO_FAR, UNCERTAIN, IS_SKY, IS_PERSON = range(6)


def _judge_points(odometry: OdometryResult, labels: PointLabels, settings: SubmapSettings) -> NDArray[np.int8]:
    """(P,) the reason, an index into NAMES, for which each point is kept or left out."""
    verdict = np.empty(len(odometry.points), np.int8)
    for first in range(0, len(verdict), POINTS_AT_ONCE):
        rows = slice(first, first + POINTS_AT_ONCE)
        verdict[rows] = _verdict(odometry.points.inverse_depth[rows], odometry.points.variance[rows], labels.stereo[rows], settings)
    return verdict


def _verdict(
    inverse_depth: NDArray[np.float32], of_depth: NDArray[np.float32], label: NDArray[np.uint8], settings: SubmapSettings
) -> NDArray[np.int8]:
    """Of points (n,) with variances of_depth."""
    d, variance = inverse_depth.astype(np.float64), of_depth.astype(np.float64)
    has_depth = np.isfinite(d) & (d > 0.0) & np.isfinite(variance) & (variance >= 0.0)
    d = np.where(has_depth, d, 1.0)
    depth_sigma = np.sqrt(np.where(has_depth, variance, 0.0)) / d**2
    uncertain = (depth_sigma > settings.max_depth_sigma_m) & (depth_sigma * d > settings.max_depth_sigma_share)
    verdict = np.full(len(d), KEPT, np.int8)
    verdict[label == SKY] = IS_SKY
    verdict[uncertain] = UNCERTAIN
    verdict[d < 1.0 / settings.max_distance_m] = TOO_FAR
    verdict[~has_depth] = NO_DEPTH
    if not settings.keep_persons:
        verdict[np.isin(label, PERSONS)] = IS_PERSON
    return verdict


def _submap(
    odometry: OdometryResult,
    labels: PointLabels,
    verdict: NDArray[np.int8],
    hosted: IntArray,
    stretch: Stretch,
    settings: SubmapSettings,
) -> Submap:
    """The submap of a section, of the points `hosted` (n,) by its keyframes."""
    keyframes, points = odometry.keyframes, odometry.points
    rows = hosted[verdict[hosted] == KEPT]
    rows = rows[np.lexsort((rows, points.uv_host[rows, 0], points.uv_host[rows, 1], points.host[rows]))]
    T_submap_cam = se3.inverse(keyframes.T_world_cam[stretch.anchor]) @ keyframes.T_world_cam[stretch.keyframes]
    host = points.host[rows] - stretch.keyframes[0]
    xyz, variance = _positions(odometry, rows, T_submap_cam[host], settings)
    start, taken = _take_ragged(labels.vote_start, rows)
    if not settings.keep_persons:
        start, taken = _without(start, taken, np.isin(labels.vote_class[taken], PERSONS))
    t_ns = odometry.trajectory.t_ns[keyframes.frame[stretch.keyframes]]
    counts = Counter(verdict[hosted].tolist())
    return Submap(
        xyz=xyz,
        label=labels.stereo[rows],
        variance=variance,
        grey=points.grey[rows],
        seen_ns=t_ns[host],
        keyframe=host.astype(np.uint32),
        vote_start=start.astype(np.uint32),
        vote_class=labels.vote_class[taken],
        vote_weight=labels.vote_weight[taken],
        keyframe_frame=keyframes.frame[stretch.keyframes].astype(np.uint32),
        keyframe_t_ns=t_ns,
        T_submap_cam=T_submap_cam,
        length_m=round(stretch.length_m, 3),
        points_left_out={NAMES[code]: counts[code] for code in range(NO_DEPTH, len(NAMES)) if counts[code]},
    )


def _positions(
    odometry: OdometryResult, rows: IntArray, T_submap_host: FloatArray, settings: SubmapSettings
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """xyz (P, 3) m in the submap's frame, and variance (P,) m^2 along the worst axis.

    Along the ray sigma_z = sigma_d / d^2 times the ray's length; across it pixel_sigma z / f. The larger counts, plus a floor.
    """
    camera = odometry.rig.camera
    rays = camera.rays(odometry.points.uv_host[rows].astype(np.float64))
    d = odometry.points.inverse_depth[rows].astype(np.float64)
    xyz = np.einsum("nij,nj->ni", T_submap_host[:, :3, :3], rays / d[:, None]) + T_submap_host[:, :3, 3]
    along = odometry.points.variance[rows] / d**4 * (rays**2).sum(axis=1)
    across = (settings.pixel_sigma / (camera.fx * d)) ** 2
    return xyz.astype(np.float32), (np.maximum(along, across) + settings.position_floor_m**2).astype(np.float32)


def _take_ragged(start: IntArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    """The new start (P + 1,) and the old places (V,) of the entries of these rows of a ragged table."""
    length = start[rows + 1] - start[rows]
    new = np.concatenate([[0], np.cumsum(length)])
    return new, np.repeat(start[rows] - new[:-1], length) + np.arange(new[-1])


def _without(start: IntArray, places: IntArray, dropped: NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """A ragged table, start (P + 1,) of places (V,), without the entries that are dropped (V,)."""
    kept = np.concatenate([[0], np.cumsum(~dropped)])
    return kept[start], places[~dropped]


def _steps(told: Anchors, anchors: IntArray) -> list[StepBefore | None]:
    """(S - 1) what the drive's graph tells of each submap and the one before; None where it was asked of other frames."""
    if not np.array_equal(told.frame, anchors):
        return [None] * (len(anchors) - 1)
    return [StepBefore(cross, bool(connected)) for cross, connected in zip(told.cross, told.connected, strict=True)]


def _place(
    submap: Submap, geo: GeoReference, anchor: int, drive_id: str, before: StepBefore | None, stretch2: float
) -> PlacedSubmap:
    """Pose of a submap: the mean of the poses that its keyframes give its origin.

    Rigidly joined frames share their left perturbation, so the anchor's covariance would be the submap's, were the drive in its
    graph as stiff as the submap. It is not: GNSS, loops and the scale bend it, and by so much any one of its keyframes, the anchor
    like others, lies elsewhere than the submap has it.
    """
    proposed = geo.T_enu_cam[submap.keyframe_frame] @ se3.inverse(submap.T_submap_cam)
    T_enu_submap = mean_motion(proposed)
    bend = np.array([se3.log(T) for T in se3.inverse(T_enu_submap) @ proposed])
    xi = bend @ se3.adjoint(T_enu_submap).T
    covariance = geo.covariance[anchor] + xi.T @ xi / len(xi)  # second moment of what takes the submap to the proposed
    told = noticed(bend, submap.T_submap_cam, stretch2)
    return PlacedSubmap(submap, T_enu_submap, covariance, drive_id, geo.frame, before, told)
