"""Temporally consistent labelling (TCL): weighted majority vote of the images in which a point is visible.

"Vision-based Large-scale 3D Semantic Mapping for Autonomous Driving Applications" (Cheng, Zeller, Cremers; 2022), sec. III-C:

    l(p) = argmax_c  sum_{q_j in Q}  w_j [L_j(q_j) = c]            (eq. 2)
    w_j  = d_j  where  d_j < 1 / dist_min,  else 0                  (eq. 3)

Q holds the point in its host's left image, its projections into the left image of every keyframe j of obs(p), and the projections
of those into the right images; d_j is its inverse depth in j. Only right images with which the odometry found the point consistent
vote.

Beyond the paper, each by a setting: visibility in further keyframes by the normalised cross-correlation of patches (the odometry's
obs(p) ends with its window); soft votes by the network's probabilities; a depth test against occlusion; less weight near label
boundaries and for uncertain projections; votes of the frames between keyframes; smoothing over neighbours in space; class prior
correction.

Points are taken host by host, so what is in memory is bounded by the keyframes within reach; time is linear in points x observers.
"""

import itertools
import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, VOID
from wayloom.config.progress import Progress, silent
from wayloom.files.growing_arrays import GrowingArray, forget_pages
from wayloom.geometry import se3
from wayloom.labelling.class_prior import class_prior_correction, class_prior_factors
from wayloom.labelling.images import LabelImages, VoterImageCache
from wayloom.labelling.kernels.visibility import occlusion_buffer
from wayloom.labelling.kernels.voting import argmax_classes, put_votes, sparse_votes
from wayloom.labelling.neighbours import NeighbourSearch, smoothed, smoothed_labels
from wayloom.labelling.projection import CELL_PX, HostedPoints, Projections, add_votes, host_descriptors
from wayloom.labelling.settings import LabellingSettings
from wayloom.labelling.types import PointLabels, SparseVotes
from wayloom.labelling.voting_frames import right_images_vote, voting_frames
from wayloom.odometry.types import POINTS_AT_ONCE, OdometryResult

MIN_VOTE_SHARE = 0.01
"""Of soft votes, a class that got less than this share of its point's votes is not kept with the point."""
MAX_CACHED_VOTERS = 256
"""Voters in memory at most, whatever the reach."""
MONO, STEREO = 0, 1
HOSTS_AT_ONCE = 256
"""So many hosts' votes are in memory when they are read from their files."""


@dataclass(frozen=True, slots=True)
class Voters:
    """The frames whose images vote.

    frame                     (V,) the log's frame of each voter, increasing
    T_world_cam, T_cam_world  (V, 4, 4)
    segment                   (V,)
    right                     (V,) whether the right image votes as well
    of_keyframe               (K,) row of the voter that each keyframe is
    """

    frame: NDArray[np.int32]
    T_world_cam: NDArray[np.float64]
    T_cam_world: NDArray[np.float64]
    segment: NDArray[np.int32]
    right: NDArray[np.bool_]
    of_keyframe: NDArray[np.int64]


def label_points(
    odometry: OdometryResult,
    images: LabelImages,
    settings: LabellingSettings = LabellingSettings(),
    progress: Progress = silent,
) -> PointLabels:
    """Label the odometry's P points by the label images of its keyframes (eqs. 2 and 3), one host after the other.

    images : by the row of `voting_frames`, which is the keyframe's row unless frames between keyframes vote
    A void pixel does not vote. Of classes with equal votes the baseline's wins, else the lowest. A point on which nothing votes
    keeps its baseline. In the paper's form a point seen only by its host has its baseline as mono label.
    Raises StageError where an image is missing or has not the size of the rig's camera.
    """
    points, count = odometry.points, len(odometry.keyframes)
    voters = _voters(odometry, settings)
    cache = VoterImageCache(images, voters.right, odometry.rig, _cache_capacity(odometry, voters, settings), settings)
    buffers = _OcclusionBuffers(odometry) if settings.occlusion_check else None
    labels = np.full((3, len(points)), VOID, np.uint8)
    min_share = MIN_VOTE_SHARE if settings.votes == "soft" or settings.spread > 0 else 0.0
    by_host = _VotesByHost(), _VotesByHost()
    hosted = np.argsort(points.host, kind="stable")
    bounds = np.searchsorted(points.host[hosted], np.arange(count + 1))
    for k in range(count):
        progress(k / count, f"votes on the points of keyframe {k + 1} of {count}")
        rows = hosted[bounds[k] : bounds[k + 1]]
        baseline, votes = _votes_on(odometry, k, rows, voters, cache, buffers, settings)
        both = votes.sum(axis=0)
        labels[:, rows] = baseline, argmax_classes(votes[0], baseline), argmax_classes(both, baseline)
        for part, counted in zip(by_host, (votes[0], both), strict=True):
            part.append(*sparse_votes(counted, min_share))
    power = 0.0 if images.is_balanced else settings.class_prior_power
    factors = class_prior_factors(by_host[STEREO].by_point(hosted, bounds), power) if power > 0 else None

    def corrected(form: int) -> SparseVotes:
        votes = by_host[form].by_point(hosted, bounds)
        return votes if factors is None else class_prior_correction(votes, factors)

    if (settings.spread > 0 or power > 0) and len(points):
        search = NeighbourSearch(odometry, settings.spread)
        # Each form asks for the neighbours anew: held for all points, or with the votes of both forms, they are what an hour's
        # drive has no room for.
        labels[1] = smoothed_labels(corrected(MONO), search, labels[0])
        labels[2], stereo = smoothed(corrected(STEREO), search, labels[0], min_share)
    else:
        stereo = corrected(STEREO)
    progress(1.0, f"votes on the points of {count} keyframes counted")
    return PointLabels(labels[0], labels[1], labels[2], stereo.start, stereo.classes, stereo.weights)


def _voters(odometry: OdometryResult, settings: LabellingSettings) -> Voters:
    keyframes, trajectory = odometry.keyframes, odometry.trajectory
    frame = voting_frames(odometry, settings)
    of_keyframe = np.searchsorted(frame, keyframes.frame)
    T_world_cam, segment = trajectory.T_world_cam[frame].copy(), trajectory.segment[frame].copy()
    T_world_cam[of_keyframe], segment[of_keyframe] = keyframes.T_world_cam, keyframes.segment
    right = right_images_vote(len(frame), settings)
    return Voters(frame, T_world_cam, se3.inverse(T_world_cam), segment, right, of_keyframe)


def _cache_capacity(odometry: OdometryResult, voters: Voters, settings: LabellingSettings) -> int:
    """How many voters must be in memory so that none is opened twice."""
    points, of_keyframe, furthest = odometry.points, voters.of_keyframe, 0
    for first in range(0, len(points), POINTS_AT_ONCE):
        start = points.obs_start[first : first + POINTS_AT_ONCE + 1]
        host = np.repeat(of_keyframe[points.host[first : first + POINTS_AT_ONCE]], np.diff(start))
        apart = np.abs(of_keyframe[points.obs_keyframe[start[0] : start[-1]]] - host)
        furthest = max(furthest, int(apart.max(initial=0)))
    gap = int(np.diff(of_keyframe).max(initial=1))
    return min(MAX_CACHED_VOTERS, 2 * max(furthest, settings.reach * gap) + 2)


def _votes_on(
    odometry: OdometryResult,
    k: int,
    rows: NDArray[np.int64],
    voters: Voters,
    cache: VoterImageCache,
    buffers: "_OcclusionBuffers | None",
    settings: LabellingSettings,
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Baseline (N,) and votes (2, N, C), left images and right ones, on the N points of keyframe k that lie in these rows."""
    points, host = odometry.points, int(voters.of_keyframe[k])
    uv = points.uv_host[rows].astype(np.float64)
    if not len(rows):
        return np.zeros(0, np.uint8), np.zeros((2, 0, CLASS_COUNT))
    small = cache[host].small
    hosted = HostedPoints(
        uv, odometry.rig.camera.rays(uv), points.inverse_depth[rows].astype(np.float64),
        np.sqrt(np.maximum(points.variance[rows].astype(np.float64), 0.0)),
        None if small is None else host_descriptors(small[0], uv),
    )  # fmt: skip
    votes = np.zeros((2, len(rows), CLASS_COUNT))
    baseline = np.full(len(rows), VOID, np.uint8)
    for voter, left, right in _voters_of(odometry, k, rows, voters, settings):
        T_voter_host = voters.T_cam_world[voter] @ voters.T_world_cam[host]
        is_host = voter == host
        projections = Projections(is_host, left, right, buffers.of(voters, voter) if buffers else None)
        labels = add_votes(votes, hosted, np.eye(4) if is_host else T_voter_host, cache[voter], projections, odometry, settings)
        if is_host:
            baseline = labels
    return baseline, votes


def _voters_of(
    odometry: OdometryResult, k: int, rows: NDArray[np.int64], voters: Voters, settings: LabellingSettings
) -> Iterator[tuple[int, NDArray[np.bool_], NDArray[np.bool_]]]:
    """The voters of the points of keyframe k in these rows, in time order: row of the voter, and (N,) which points are projected
    into its left and into its right image: those that the odometry observed there, or all if it is within reach."""
    points, of_keyframe = odometry.points, voters.of_keyframe
    start, length = points.obs_start[rows], points.obs_start[rows + 1] - points.obs_start[rows]
    first = np.concatenate([[0], np.cumsum(length)])
    taken = np.repeat(start - first[:-1], length) + np.arange(first[-1])
    of_point = np.repeat(np.arange(len(rows)), length)
    observer = of_keyframe[points.obs_keyframe[taken]]
    host = int(of_keyframe[k])
    reach = (of_keyframe[max(0, k - settings.reach)], of_keyframe[min(len(of_keyframe) - 1, k + settings.reach)])
    near = np.arange(reach[0], reach[1] + 1) if settings.reach else np.array([host])
    near = near[voters.segment[near] == voters.segment[host]]
    reached = set(near.tolist()) if settings.reach else set()
    beyond = np.flatnonzero((observer < reach[0]) | (observer > reach[1])) if reached else np.arange(len(observer))
    taken, of_point, observer = taken[beyond], of_point[beyond], observer[beyond]
    by_observer = np.argsort(observer, kind="stable")
    chosen = np.unique(np.concatenate([observer, near, [host]]))
    bounds = np.searchsorted(observer[by_observer], np.append(chosen, chosen[-1] + 1)).tolist()
    all_points, none = np.ones(len(rows), bool), np.zeros(len(rows), bool)
    for i, voter in enumerate(chosen.tolist()):
        if voter in reached:
            yield voter, all_points, all_points if voters.right[voter] else none
            continue
        left, right = np.zeros(len(rows), bool), np.zeros(len(rows), bool)
        here = by_observer[bounds[i] : bounds[i + 1]]
        left[of_point[here]], right[of_point[here]] = True, points.obs_right[taken[here]]
        if voter == host:
            left[:], right[:] = True, points.host_right[rows]
        yield voter, left, right if voters.right[voter] else none


class _OcclusionBuffers:
    """Occlusion buffer of each keyframe, of the points that the odometry observed there; the last few stay in memory."""

    def __init__(self, odometry: OdometryResult) -> None:
        points = odometry.points
        self._camera, self._world = odometry.rig.camera, odometry.points_world()
        self._keyframe = np.concatenate([points.host, points.obs_keyframe])
        self._point = np.concatenate([np.arange(len(points)), np.repeat(np.arange(len(points)), np.diff(points.obs_start))])
        self._point = self._point[np.argsort(self._keyframe, kind="stable")]
        self._bounds = np.searchsorted(np.sort(self._keyframe), np.arange(len(odometry.keyframes) + 1))
        self._buffers: OrderedDict[int, NDArray[np.float32]] = OrderedDict()

    def of(self, voters: Voters, voter: int) -> NDArray[np.float32] | None:
        """`occlusion_buffer` of the voter's left image; None for a frame between keyframes."""
        k = int(np.searchsorted(voters.of_keyframe, voter))
        if k >= len(voters.of_keyframe) or voters.of_keyframe[k] != voter:
            return None
        if k not in self._buffers:
            T = voters.T_cam_world[voter]
            p = self._world[self._point[self._bounds[k] : self._bounds[k + 1]]] @ T[:3, :3].T + T[:3, 3]
            p = p[p[:, 2] > 0]
            size = (math.ceil(self._camera.height / CELL_PX), math.ceil(self._camera.width / CELL_PX))
            self._buffers[k] = occlusion_buffer(self._camera.project(p), 1.0 / p[:, 2], CELL_PX, *size)
            if len(self._buffers) > MAX_CACHED_VOTERS:
                self._buffers.popitem(last=False)
        return self._buffers[k]


class _VotesByHost:
    """Sparse votes on the points of one host after the other; those of a long drive lie in files."""

    def __init__(self) -> None:
        self._ends = [0]
        self._kinds, self._classes, self._sums = GrowingArray(np.uint8), GrowingArray(np.uint8), GrowingArray(np.float32)

    def append(self, kinds: NDArray[np.int64], classes: NDArray[np.uint8], sums: NDArray[np.float32]) -> None:
        """`sparse_votes` of the next host's points. Raises OSError where the disk is full."""
        for column, values in ((self._kinds, kinds), (self._classes, classes), (self._sums, sums)):
            column.append(values)
        self._ends.append(len(self._classes))

    def by_point(self, hosted: NDArray[np.int64], bounds: NDArray[np.int64]) -> SparseVotes:
        """In the order of the points: `hosted` are their rows as they came, those of host k from bounds[k] to before the next."""
        start = np.zeros(len(hosted) + 1, np.int64)
        start[1 + hosted] = self._kinds.array()
        np.cumsum(start, out=start)
        classes, weights = np.empty(start[-1], np.uint8), np.empty(start[-1], np.float32)
        all_classes, all_sums = self._classes.array(), self._sums.array()
        for k, (first, end) in enumerate(itertools.pairwise(self._ends)):
            of_host = np.array(all_classes[first:end]), np.array(all_sums[first:end])
            put_votes(hosted[bounds[k] : bounds[k + 1]], start, *of_host, classes, weights)
            if k % HOSTS_AT_ONCE == 0:
                forget_pages(all_classes)
                forget_pages(all_sums)
        return SparseVotes(start, classes, weights)
