"""What the benchmark of labels knows of a drive: labelled LiDAR points and labelled images of its frames."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.logs.image_folder_log import ImageFolderLog
from wayloom.logs.images import ImagePairs
from wayloom.logs.kitti_360 import open_kitti_360
from wayloom.logs.kitti_360_clouds import AccumulatedCloud, Window, read_cloud, windows
from wayloom.logs.kitti_360_labels import has_labels, read_semantic, train_ids
from wayloom.logs.kitti_360_layout import Sequence, find_sequences
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import SimulatedTruth, has_truth, open_truth
from wayloom.logs.types import DriveLog

FloatArray = NDArray[np.float64]
Labels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class TrueFrame:
    """What is known of one frame. points_cam (N, 3) m in its left camera with their labels (N,) train ids, 255 = void;
    image (h, w) train ids of the left image."""

    points_cam: FloatArray
    labels: Labels
    image: Labels


class LabelTruth(Protocol):
    """frame(index) is None where the image has no labels, or the frame no pose."""

    def frame(self, index: int, /) -> TrueFrame | None: ...


@dataclass(frozen=True, slots=True)
class LabelledDrive:
    """A drive and what is known of it."""

    name: str
    log: DriveLog
    truth: LabelTruth


class Kitti360Truth:
    """From KITTI-360's accumulated clouds and label images. Moving things count in the frame in which they were scanned."""

    def __init__(self, sequence: Sequence, log: ImageFolderLog) -> None:
        self._sequence, self._numbers, self._poses = sequence, log.pairs.numbers, log.truth
        self._static, self._dynamic = windows(sequence, "static"), windows(sequence, "dynamic")
        if not self._static:
            raise InputError("no labelled clouds", file=sequence.clouds / "static", remedy="get KITTI-360's data_3d_semantics")
        self._read = lru_cache(maxsize=4)(read_cloud)

    def frame(self, index: int, /) -> TrueFrame | None:
        """See `LabelTruth`."""
        number = self._numbers[index]
        if self._poses is None or not np.isfinite(self._poses[index]).all() or not has_labels(self._sequence, number):
            return None
        T_cam_world = se3.inverse(self._poses[index])
        points, labels = [np.zeros((0, 3))], [np.zeros(0, np.uint8)]
        for kind in (self._static, self._dynamic):
            for cloud in self._clouds(kind, number):
                rows = np.flatnonzero((cloud.frame < 0) | (cloud.frame == number))
                points.append(se3.transform(T_cam_world, cloud.points[rows]))
                labels.append(train_ids(cloud.semantic[rows]))
        return TrueFrame(np.concatenate(points), np.concatenate(labels), read_semantic(self._sequence, number))

    def _clouds(self, kind: list[Window], number: int) -> Iterator[AccumulatedCloud]:
        for window in kind:
            if window.first <= number <= window.last:
                yield self._read(window.file)


class DrawnTruth:
    """From the simulator's depth and class of every pixel."""

    def __init__(self, truth: SimulatedTruth, log: DriveLog) -> None:
        self._truth, camera = truth, log.rig.camera
        v, u = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
        self._rays = camera.rays(np.column_stack([u, v]).astype(np.float64))

    def frame(self, index: int, /) -> TrueFrame | None:
        """See `LabelTruth`."""
        depth, image = self._truth.depth_m(index).ravel(), self._truth.class_id(index)
        there = depth > 0
        return TrueFrame(self._rays[there] * depth[there, None].astype(np.float64), image.ravel()[there], image)


class _From:
    """The same truth for a part of a drive that begins at frame `first`."""

    def __init__(self, truth: LabelTruth, first: int) -> None:
        self._truth, self._first = truth, first

    def frame(self, index: int, /) -> TrueFrame | None:
        """See `LabelTruth`."""
        return self._truth.frame(index + self._first)


def find_labelled_drives(dataset: Path, source: str = "auto", first: int = 0, stop: int | None = None) -> list[LabelledDrive]:
    """The labelled drives of a dataset, in order.

    dataset : KITTI-360's root or a sequence's folder; a folder of drives of `wayloom simulate --truth`, or one of them
    source : "kitti-360", "drawn" (the simulator's depth and class of every pixel) or "auto": the first that is there
    first, stop : which frames of each drive
    Raises InputError where there is nothing labelled, or what is there cannot be read.
    """
    if not dataset.is_dir():
        raise InputError("no such folder", file=dataset, remedy="give KITTI-360's root, or a folder of `wayloom simulate --truth`")
    drives = _kitti_360(dataset) if source != "drawn" else []
    if not drives and source != "kitti-360":
        drives = _drawn(dataset)
    if not drives:
        raise InputError(
            "nothing labelled in it", file=dataset, remedy="give KITTI-360's root, or a folder of `wayloom simulate --truth`"
        )
    return [_part(drive, first, stop) for drive in drives]


def _kitti_360(dataset: Path) -> list[LabelledDrive]:
    try:
        found = [sequence for sequence in find_sequences(dataset) if (sequence.clouds / "static").is_dir()]
    except InputError:
        return []
    drives = []
    for sequence in found:
        log = open_kitti_360(sequence.images)
        drives.append(LabelledDrive(sequence.name, log, Kitti360Truth(sequence, log)))
    return drives


def _drawn(dataset: Path) -> list[LabelledDrive]:
    folders = [dataset] if has_truth(dataset) else [folder for folder in sorted(dataset.iterdir()) if has_truth(folder)]
    drives = []
    for folder in folders:
        log = open_log(folder)
        drives.append(LabelledDrive(folder.name, log, DrawnTruth(open_truth(folder), log)))
    return drives


def _part(drive: LabelledDrive, first: int, stop: int | None) -> LabelledDrive:
    log = drive.log
    if (first == 0 and stop is None) or not isinstance(log, ImageFolderLog):
        return drive
    rows = slice(first, stop)
    if len(log.t_ns[rows]) < 2:
        raise InputError(f"has {len(log)} frames, none from {first} to {stop}", file=log.path, remedy="choose other frames")
    pairs = ImagePairs(numbers=log.pairs.numbers[rows], left=log.pairs.left[rows], right=log.pairs.right[rows])
    part = replace(
        log,
        t_ns=log.t_ns[rows],
        truth=None if log.truth is None else log.truth[rows],
        exposure_s=None if log.exposure_s is None else log.exposure_s[rows],
        pairs=pairs,
    )
    return LabelledDrive(drive.name, part, _From(drive.truth, first))
