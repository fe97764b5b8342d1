"""Joint covariances of a drive's anchors: which nodes of its graph they are, and what becomes of the answer."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.georeference.types import Anchors
from wayloom.odometry.types import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Joints:
    """Anchors (A,), frames; pairs (A - 1, 2) rows of the nodes of each and of the next; connected (A - 1,) as in `Anchors`."""

    anchors: IntArray
    pairs: IntArray
    connected: NDArray[np.bool_]

    def told(self, cross: FloatArray) -> Anchors:
        """With the covariances (A - 1, 6, 6) of the pairs."""
        return Anchors(self.anchors, cross, self.connected)


def joints_between(trajectory: Trajectory, nodes: IntArray, anchors: IntArray) -> Joints:
    """Each of the anchors (A,), increasing frames, with the next.

    Raises StageError where one is no node of the graph, as every tracked keyframe is.
    """
    rows = np.searchsorted(nodes, anchors)
    strange = nodes[np.minimum(rows, len(nodes) - 1)] != anchors
    if strange.any():
        frame = int(anchors[np.argmax(strange)])
        raise StageError(f"frame {frame} is no node of the drive's graph, as tracked keyframes are: nothing joins it to others")
    return Joints(anchors, np.stack([rows[:-1], rows[1:]], axis=1), np.diff(trajectory.segment[anchors]) == 0)
