"""Recordings of the odometry benchmark: a log with ground-truth trajectories and depths."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.evaluation.odometry_depth import DepthTruth, LidarDepth, TruthImages
from wayloom.evaluation.recordings import from_frame, ins_truth
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog, StereoFrame

FloatArray = NDArray[np.float64]
CLIP_A = Path("kitti_odometry/sequences/00")
CLIP_B = Path("kitti_raw/2011_09_26/2011_09_26_drive_0005_sync")
CLIP_A_WRONG_UNTIL = 16
"""KITTI's poses of clip A step a constant 0.86 m in their first frames, while the images accelerate."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording with what is known of it.

    numbers  (N,) the frames' numbers in the depth truth; frames left out leave gaps
    truths   name to T_world_cam (N, 4, 4), NaN where unknown
    depth    None where nothing is known of depths
    """

    name: str
    log: DriveLog
    numbers: NDArray[np.int64]
    truths: dict[str, FloatArray]
    depth: DepthTruth | None


class Thinned:
    """A log of which only the frames `kept` (M,) are there, with their own time stamps; everything else is the log's."""

    def __init__(self, log: DriveLog, kept: NDArray[np.int64]) -> None:
        self._log, self.kept, self.t_ns = log, kept, log.t_ns[kept]
        self.truth = None if log.truth is None else log.truth[kept]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # copy and pickle look for these before __init__ has run
            raise AttributeError(name)
        return getattr(self._log, name)

    def __len__(self) -> int:
        return len(self.kept)

    def frame(self, index: int) -> StereoFrame:
        """Pair `index` of those kept."""
        return replace(self._log.frame(int(self.kept[index])), index=index)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[StereoFrame]:
        """The kept pairs from start to stop in order."""
        for index in range(start, len(self) if stop is None else min(stop, len(self))):
            yield self.frame(index)


def thinned(recording: Recording, step: int) -> Recording:
    """The recording with only every `step`-th frame."""
    return with_frames(recording, np.arange(0, len(recording.log), step), recording.name)


def piece(recording: Recording, first: int, stop: int) -> Recording:
    """Frames first to stop of a recording, named `A 16:67`. Raises InputError where it does not have them."""
    if not 0 <= first < stop <= len(recording.log):
        what = f"{recording.name} has {len(recording.log)} frames, not {first} to {stop}"
        raise InputError(what, remedy="name frames that it has")
    return with_frames(recording, np.arange(first, stop), f"{recording.name} {first}:{stop}")


def with_frames(recording: Recording, kept: NDArray[np.int64], name: str) -> Recording:
    """The recording with only the frames kept (M,), by another name."""
    truths = {truth: poses[kept] for truth, poses in recording.truths.items()}
    return Recording(name, Thinned(recording.log, kept), recording.numbers[kept], truths, recording.depth)


def clip_recordings(data: Path) -> list[Recording]:
    """Those of clip A (KITTI odometry 00, its first 201 frames) and clip B (KITTI raw 2011_09_26_0005) that lie in `data`."""
    found = []
    if (data / CLIP_A).is_dir():
        log = open_log(data / CLIP_A)
        truths = {}
        if log.truth is not None:
            truths = {"poses": log.truth, f"poses from frame {CLIP_A_WRONG_UNTIL}": from_frame(log.truth, CLIP_A_WRONG_UNTIL)}
        found.append(Recording("A", log, np.arange(len(log)), truths, None))
    if (data / CLIP_B).is_dir():
        log = open_log(data / CLIP_B)
        truths = {"INS velocities": ins_truth(data / CLIP_B, log)}
        found.append(Recording("B", log, np.arange(len(log)), truths, LidarDepth.of_kitti_raw(log)))
    return found


def recording_of(folder: Path, name: str | None = None) -> Recording:
    """A drive with its own poses as truth, as `wayloom simulate --truth` writes it; depths from its `truth` folder if it has one.

    Raises InputError where the folder is no log, or one without poses.
    """
    log = open_log(folder)
    if log.truth is None:
        raise InputError("has no poses to be measured against", file=folder, remedy="simulate the drive, or add its poses")
    depth = TruthImages.beside(log)
    return Recording(name or log.name, log, np.arange(len(log)), {"poses": log.truth}, depth)
