"""Ground truth of the label benchmark: labelled LiDAR points and labelled images of a drive's frames."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.logs.images.image_files import ImagePairs
from wayloom.logs.kitti.accumulation import Scan, window_frames, window_rows
from wayloom.logs.kitti.image_folder_log import ImageFolderLog
from wayloom.logs.kitti.kitti_360 import open_kitti_360
from wayloom.logs.kitti.kitti_360_clouds import AccumulatedCloud, cloud_of, read_cloud, windows
from wayloom.logs.kitti.kitti_360_labels import has_labels, label_ids, read_semantic, train_ids
from wayloom.logs.kitti.kitti_360_layout import Sequence, find_sequences
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import SimulatedTruth, has_truth, open_truth, scan_file
from wayloom.logs.types import DriveLog

FloatArray = NDArray[np.float64]
Labels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class TrueFrame:
    """Ground truth of one frame. points_cam (N, 3) m in its left camera with their labels (N,) train ids, 255 = void;
    image (h, w) train ids of the left image."""

    points_cam: FloatArray
    labels: Labels
    image: Labels


class LabelTruth(Protocol):
    """frame(index) is None where the image has no labels, or the frame no pose."""

    def frame(self, index: int, /) -> TrueFrame | None: ...


@dataclass(frozen=True, slots=True)
class LabelledDrive:
    """A drive and its ground truth."""

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
        image = read_semantic(self._sequence, number)
        return _seen_in(number, self._poses[index], self._clouds(number), image)

    def _clouds(self, number: int) -> Iterator[AccumulatedCloud]:
        for window in (*self._static, *self._dynamic):
            if window.first <= number <= window.last:
                yield self._read(window.file)


class ScannedTruth:
    """From the simulator's labelled scans, accumulated as they are for the clouds of KITTI-360's layout: the same points."""

    def __init__(self, truth: SimulatedTruth) -> None:
        self._truth = truth
        self._accumulated = lru_cache(maxsize=2)(self._window)

    @cached_property
    def _windows(self) -> list[tuple[int, int]]:
        return window_frames(self._truth.T_enu_cam)

    def frame(self, index: int, /) -> TrueFrame | None:
        """See `LabelTruth`."""
        near = [self._accumulated(first, last) for first, last in self._windows if first <= index <= last]
        clouds = [pair[0] for pair in near] + [pair[1] for pair in near]
        return _seen_in(index, self._truth.T_enu_cam[index], clouds, self._truth.class_id(index))

    def _window(self, first: int, last: int) -> tuple[AccumulatedCloud, AccumulatedCloud]:
        still, moving = window_rows(self._truth.T_enu_cam, first, last, self._scan)
        return replace(cloud_of(still), frame=np.full(len(still), -1, np.int32)), cloud_of(moving)

    def _scan(self, index: int) -> Scan | None:
        scan = self._truth.scan(index)
        if scan is None:
            return None
        count, ids = len(scan.points_cam), label_ids(scan.labels)
        colours, visible = np.zeros((count, 3), np.uint8), np.ones(count, bool)
        return Scan(scan.points_cam, colours, visible, ids, scan.instances.astype(np.int32), scan.moving)


def _seen_in(number: int, T_world_cam: FloatArray, clouds: Iterable[AccumulatedCloud], image: Labels) -> TrueFrame:
    """The points of clouds that were there at frame `number`: static ones, and moving ones of that very frame."""
    T_cam_world = se3.inverse(T_world_cam)
    points, labels = [np.zeros((0, 3))], [np.zeros(0, np.uint8)]
    for cloud in clouds:
        rows = np.flatnonzero((cloud.frame < 0) | (cloud.frame == number))
        points.append(se3.transform(T_cam_world, cloud.points[rows]))
        labels.append(train_ids(cloud.semantic[rows]))
    return TrueFrame(np.concatenate(points), np.concatenate(labels), image)


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
    source : "kitti-360"; "scanned" (the simulator's labelled scans, for drives that have any); "drawn" (its depth and class of
    every pixel); or "auto": the first that is there
    first, stop : which frames of each drive
    Raises InputError where there is nothing labelled, or what is there cannot be read.
    """
    if not dataset.is_dir():
        raise InputError("no such folder", file=dataset, remedy="give KITTI-360's root, or a folder of `wayloom simulate --truth`")
    drives = _kitti_360(dataset) if source in ("auto", "kitti-360") else []
    if not drives and source != "kitti-360":
        drives = _simulated(dataset, source)
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


def _simulated(dataset: Path, source: str) -> list[LabelledDrive]:
    folders = [dataset] if has_truth(dataset) else [folder for folder in sorted(dataset.iterdir()) if has_truth(folder)]
    drives = []
    for folder in folders:
        log, truth = open_log(folder), open_truth(folder)
        scanned = source != "drawn" and any(scan_file(folder, index).is_file() for index in range(len(log)))
        if scanned or source != "scanned":
            drives.append(LabelledDrive(folder.name, log, ScannedTruth(truth) if scanned else DrawnTruth(truth, log)))
    return drives


def _part(drive: LabelledDrive, first: int, stop: int | None) -> LabelledDrive:
    if first == 0 and stop is None:
        return drive
    return LabelledDrive(drive.name, part_of(drive.log, first, stop), _From(drive.truth, first))


def part_of(log: DriveLog, first: int, stop: int | None) -> DriveLog:
    """The frames from `first` to before `stop` of a log of image files. Raises InputError for other logs, and without frames."""
    if not isinstance(log, ImageFolderLog):
        raise InputError(f"no part can be taken of a {log.format} log", file=log.path, remedy="take the whole drive")
    rows = slice(first, stop)
    if len(log.t_ns[rows]) < 2:
        raise InputError(f"has {len(log)} frames, none from {first} to {stop}", file=log.path, remedy="choose other frames")
    return replace(
        log,
        t_ns=log.t_ns[rows],
        truth=None if log.truth is None else log.truth[rows],
        exposure_s=None if log.exposure_s is None else log.exposure_s[rows],
        pairs=ImagePairs(numbers=log.pairs.numbers[rows], left=log.pairs.left[rows], right=log.pairs.right[rows]),
    )
