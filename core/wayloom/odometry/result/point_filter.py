"""Filter of the points that left the window, and the points that pass it. Both can be done in parts."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.files.growing_arrays import GrowingArray
from wayloom.odometry.kernels.arrays import LEFT_ALIKE, RIGHT, RIGHT_ALIKE
from wayloom.odometry.types import Points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PointFilter:
    """What a point needs: so many keyframes beside the host that saw it, so many images that agree (left and right ones of
    observers, and the host's right one), and a depth whose sigma is less than so much of it.

    In a segment with few keyframes all the others must have seen it; where its host is the only one, the host's right image must
    agree.
    """

    observations: int
    confirmations: int
    relative_sigma: float

    @property
    def enough_others(self) -> int:
        """Keyframes beside the host, from which on more of them change nothing."""
        return max(self.observations, self.confirmations - 1)

    def passes(self, observers: IntArray, images: IntArray, others: IntArray, rho: FloatArray, variance: FloatArray) -> BoolArray:
        """(n,) of points that `observers` keyframes saw, with `images` that agree, in segments of `others` keyframes beside the
        host."""
        confirmed = (observers >= np.minimum(self.observations, others)) & (images >= np.minimum(self.confirmations, others + 1))
        return np.asarray(confirmed & (np.sqrt(variance) < self.relative_sigma * rho))


class KeptPoints:
    """The result's points, appended in the order of their numbers."""

    def __init__(self) -> None:
        self.host, self.uv = GrowingArray(np.int32), GrowingArray(np.float32, (2,))
        self.rho, self.variance = GrowingArray(np.float32), GrowingArray(np.float32)
        self.grey, self.host_right = GrowingArray(np.uint8), GrowingArray(np.bool_)
        self.obs_start = GrowingArray(np.int64)
        self.obs_start.append(np.zeros(1, np.int64))
        self.obs_keyframe, self.obs_right = GrowingArray(np.int32), GrowingArray(np.bool_)

    def append(
        self, columns: Mapping[str, NDArray[np.generic]], seen: IntArray, others: IntArray, point_filter: PointFilter
    ) -> None:
        """Those of the points (n), numbered higher than all before, that pass the filter.

        columns : `id` and the rest as of `ResultBuilder.add_points`; seen (m, 3): point, keyframe, what is noted of it
        (`arrays.RIGHT` …), a pair perhaps twice, from when the point was immature and from when it was live; others (n,)
        keyframes of its segment beside its host. The filter counts photometric inliers; those whose patches also correlate with
        the host's (normalised cross-correlation, `arrays.LEAST_ALIKE`) are the result's observations.
        """
        order = np.argsort(columns["id"], kind="stable")
        column = {name: values[order] for name, values in columns.items()}
        pair = seen[:, 0] * (seen[:, 1].max(initial=0) + 1) + seen[:, 1]
        seen = seen[np.unique(pair, return_index=True)[1]]  # of equal ones the first
        row = np.searchsorted(column["id"], seen[:, 0])
        observers = np.bincount(row, minlength=len(order))
        agree = np.bincount(row[seen[:, 2] & RIGHT > 0], minlength=len(order))
        images = observers + agree + column["host_right"].astype(np.int64)
        rho, variance = column["rho"].astype(np.float64), column["variance"].astype(np.float64)
        good = point_filter.passes(observers, images, others[order], rho, variance)
        for name in ("host", "uv", "rho", "variance", "grey", "host_right"):
            getattr(self, name).append(column[name][good])
        correlated = good[row] & (seen[:, 2] & LEFT_ALIKE > 0)
        self.obs_start.append(len(self.obs_keyframe) + np.cumsum(np.bincount(row[correlated], minlength=len(order))[good]))
        self.obs_keyframe.append(seen[correlated, 1])
        self.obs_right.append(seen[correlated, 2] & RIGHT_ALIKE > 0)

    def extend(self, points: Points) -> None:
        """Append points that passed the filter elsewhere, by rows of the same keyframes."""
        self.obs_start.append(len(self.obs_keyframe) + points.obs_start[1:])
        columns = ("host", points.host), ("uv", points.uv_host), ("rho", points.inverse_depth), ("variance", points.variance)
        others = ("grey", points.grey), ("host_right", points.host_right)
        for name, values in (*columns, *others, ("obs_keyframe", points.obs_keyframe), ("obs_right", points.obs_right)):
            getattr(self, name).append(values)

    def __len__(self) -> int:
        return len(self.host)

    def points(self) -> Points:
        """All of them; nothing is appended later."""
        return Points(
            self.host.array(), self.uv.array(), self.rho.array(), self.variance.array(), self.grey.array(), self.obs_start.array(),
            self.obs_keyframe.array(), self.obs_right.array(), self.host_right.array(),
        )  # fmt: skip
