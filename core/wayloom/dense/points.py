"""Dense points of what stands beside the road: voxels that the dense depth of several keyframes agrees on.

One keyframe's stereo is off by metres at edges and far away, and alike over a whole edge; another keyframe, a few metres on, sees
the edge before something else. So a voxel counts that several tell of.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.dense.extraction import dense_depth
from wayloom.dense.settings import LookSettings
from wayloom.geometry import se3
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import one_opencv_thread
from wayloom.odometry.types import OdometryResult
from wayloom.places.road import road_m, spaced
from wayloom.places.stereo_pair import LeftLabels, read_pair, right_rectifier

FloatArray = NDArray[np.float64]
STANDING: Final = tuple(
    CLASS_ID[name] for name in ("building", "wall", "fence", "pole", "traffic light", "traffic sign", "vegetation")
)
"""Train ids of what stands beside the road and stays."""
VOXEL_M: Final = 0.10
REACH_M: Final = 20.0
KEYFRAMES: Final = 2
"""A voxel counts that so many keyframes tell of."""


class Keyframed(Protocol):
    """What is asked of a submap: the frames (K,) of its keyframes, and T_submap_cam (K, 4, 4)."""

    @property
    def keyframe_frame(self) -> NDArray[np.uint32]: ...
    @property
    def T_submap_cam(self) -> FloatArray: ...


@dataclass(frozen=True, slots=True)
class DensePoints:
    """Voxels of one submap: xyz (N, 3) m, the mean of what was seen in each, submap frame; label (N,) uint8 the train id that most
    pixels had, the lowest of equals; keyframes (N,) how many tell of it."""

    xyz: FloatArray
    label: NDArray[np.uint8]
    keyframes: NDArray[np.int64]


def dense_points(
    log: DriveLog,
    odometry: OdometryResult,
    images: LeftLabels,
    submaps: Iterable[Keyframed],
    settings: LookSettings = LookSettings(),
    least: int = KEYFRAMES,
) -> Iterator[DensePoints]:
    """The voxels of each submap that at least so many of its keyframes, as far apart as the settings say, tell of.

    Raises StageError where an image's labels are missing, LogError where an image cannot be read.
    """
    keyframes, rectifier, camera = odometry.keyframes, right_rectifier(odometry), odometry.rig.camera
    chosen = spaced(road_m(keyframes.T_world_cam), keyframes.segment, settings.spacing_m)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1).astype(np.float64)
    rays = camera.rays(np.column_stack([u, v]))
    for submap in submaps:
        rows = np.searchsorted(keyframes.frame, submap.keyframe_frame)
        seen: list[tuple[FloatArray, NDArray[np.uint8]]] = []
        with one_opencv_thread():
            for row, T_submap_cam in zip(rows.tolist(), submap.T_submap_cam, strict=True):
                if chosen[row]:
                    pair = read_pair(log, int(keyframes.frame[row]), images.left(row), rectifier)
                    depth, label = dense_depth(pair, odometry.rig, odometry.disparity_bias_px, settings).ravel(), pair.label.ravel()
                    kept = np.isin(label, STANDING) & (depth < REACH_M)  # NaN is not
                    seen.append((se3.transform(T_submap_cam, rays[kept] * depth[kept, None]), label[kept]))
        yield voxels(seen, least)


def voxels(seen: Sequence[tuple[FloatArray, NDArray[np.uint8]]], least: int) -> DensePoints:
    """Voxels that points (N, 3) m with labels (N,), in one frame, of at least so many of the keyframes fall into."""
    xyz = np.concatenate([np.zeros((0, 3)), *(points for points, _ in seen)])
    label = np.concatenate([np.zeros(0, np.uint8), *(labels for _, labels in seen)])
    keyframe = np.repeat(np.arange(len(seen)), [len(points) for points, _ in seen])
    cells, voxel = np.unique(np.floor(xyz / VOXEL_M).astype(np.int64), axis=0, return_inverse=True)
    voxel, count = voxel.ravel(), len(cells)
    told = np.unique(np.column_stack([voxel, keyframe]), axis=0)[:, 0]
    keyframes = np.bincount(told, minlength=count)
    votes, pixels = np.unique(np.column_stack([voxel, label]), axis=0, return_counts=True)
    order = np.lexsort((votes[:, 1], -pixels, votes[:, 0]))
    first = order[np.searchsorted(votes[order, 0], np.arange(count))]
    total = np.bincount(voxel, minlength=count)
    mean = np.column_stack([np.bincount(voxel, axis, count) / total for axis in xyz.T]) if count else np.zeros((0, 3))
    kept = keyframes >= least
    return DensePoints(mean[kept], votes[first, 1].astype(np.uint8)[kept], keyframes[kept])
