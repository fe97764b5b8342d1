"""Loop closures between keyframes as links between nodes of a drive's graph, and what became of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.loops.types import LoopClosures
from wayloom.mapping.drive_types import OdometryChain
from wayloom.mapping.loop_factors import LoopLinks, loop_errors, loop_links
from wayloom.odometry.types import Keyframes

FloatArray = NDArray[np.float64]


def closure_links(closures: LoopClosures, keyframes: Keyframes, nodes: NDArray[np.int64], chain: OdometryChain) -> LoopLinks:
    """The closures whose two keyframes are nodes (every tracked one is).

    nodes : (K,) frames, increasing, of the chain's nodes
    Raises StageError where a closure names a keyframe that the drive does not have.
    """
    ends = np.stack([closures.first, closures.second]).astype(np.int64)
    if ends.size and (ends.min() < 0 or ends.max() >= len(keyframes)):
        raise StageError(f"closures name keyframe {int(ends.max())} of {len(keyframes)}: loops and odometry are of different runs")
    frames = keyframes.frame[ends].astype(np.int64)
    rows = np.minimum(np.searchsorted(nodes, frames), len(nodes) - 1)
    there = (nodes[rows] == frames).all(axis=0)
    return loop_links(rows[0, there], rows[1, there], closures.T_first_second[there], closures.covariance[there], chain)


def closures_report(
    links: LoopLinks, closed: NDArray[np.bool_], T_enu_node: FloatArray, nodes: NDArray[np.int64]
) -> dict[str, Any]:
    """JSON-ready facts: closures used and refused, and how far from the drive each refused visit lies.

    closed : (V,) visits that are used; T_enu_node : (K, 4, 4); nodes : (K,) frames
    """
    if not len(links):
        return {"used": 0, "refused": []}
    apart_m = np.linalg.norm(loop_errors(links, T_enu_node)[:, :3], axis=1)
    used = closed[links.visit]
    _, first = np.unique(links.visit, return_index=True)
    return {
        "used": int(used.sum()),
        "residual_rms_m": round(float(np.sqrt((apart_m[used] ** 2).mean())), 4) if used.any() else None,
        "refused": [
            {
                "frames": [int(nodes[links.first[row]]), int(nodes[links.second[row]])],
                "closures": int((links.visit == links.visit[row]).sum()),
                "apart_m": round(float(apart_m[row]), 3),
            }
            for row in first[~closed]
        ],
    }
