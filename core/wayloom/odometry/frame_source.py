"""Source of stereo frames for the odometry: grey pairs of a log, checked, and decoded ahead where threads allow."""

import functools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.geometry.lens import IDENTITY, RightLens, displaced
from wayloom.logs.types import DriveLog
from wayloom.odometry.rig import rows
from wayloom.odometry.stopwatch import Stopwatch
from wayloom.odometry.tracking import pyramid
from wayloom.odometry.tracking.frame import GreyPair

Image = NDArray[np.uint8]
SMALLEST_SIDE = 64
EXCHANGED_LEAST, EXCHANGED_FACTOR = 200, 5


class _OpenCV:
    """Of this process: blocks of `one_opencv_thread` that are open, and OpenCV's threads before the first of them."""

    lock = Lock()
    blocks = 0
    threads_before = 0


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """OpenCV works in the calling thread only, as before when the last block is left: several threads may be in one."""
    with _OpenCV.lock:
        if _OpenCV.blocks == 0:
            _OpenCV.threads_before = cv2.getNumThreads()
            cv2.setNumThreads(1)
        _OpenCV.blocks += 1
    try:
        yield
    finally:
        with _OpenCV.lock:
            _OpenCV.blocks -= 1
            if _OpenCV.blocks == 0:
                cv2.setNumThreads(_OpenCV.threads_before)


def grey_pair(log: DriveLog, index: int) -> GreyPair:
    """Pair `index` of the log; raises LogError where an image cannot be read or does not have the rig's size, for the right image
    when it is asked for."""
    t_ns = int(log.t_ns[index])
    read_side = getattr(type(log), "grey_side", None)  # of the type: a log that wraps another one may count frames otherwise
    if read_side is None:
        frame = log.frame(index)
        left, right = (_checked(log, index, right, pyramid.grey(image)) for right, image in enumerate((frame.left, frame.right)))
        return GreyPair(index, t_ns, left, lambda: right)
    right_of_log = functools.partial(_read_side, log, read_side, index, True)
    return GreyPair(index, t_ns, _read_side(log, read_side, index, False), right_of_log)


def _read_side(log: DriveLog, read_side: Callable[..., Image], index: int, right: bool) -> Image:
    return _checked(log, index, right, np.ascontiguousarray(read_side(log, index, right)))


def _checked(log: DriveLog, index: int, right: int, image: Image) -> Image:
    """The image, if it has the rig's size."""
    camera = log.rig.camera
    if image.shape != (camera.height, camera.width):
        side = "right" if right else "left"
        raise LogError(
            f"the {side} image has {image.shape[1]}x{image.shape[0]} px, the calibration {camera.width}x{camera.height}",
            file=log.path, record=f"frame {index}", remedy="give the calibration of these images",
        )  # fmt: skip
    return image


def check_rig(log: DriveLog) -> None:
    """Raises CalibrationError where the rig cannot be tracked with, LogError where there is nothing to track."""
    camera = log.rig.camera
    if min(camera.width, camera.height) < SMALLEST_SIDE:
        raise CalibrationError(
            f"images of {camera.width}x{camera.height} px are too small",
            file=log.path,
            remedy=f"{SMALLEST_SIDE} px at least are needed",
        )
    if not log.rig.baseline_m > 0:
        raise CalibrationError(
            f"the baseline is {log.rig.baseline_m:g} m",
            file=log.path,
            remedy="the right camera must lie to the right of the left one",
        )
    if not len(log):
        raise LogError("no stereo pair", file=log.path)


def frames(log: DriveLog, threads: int, stopwatch: Stopwatch, levels: int) -> Iterator[GreyPair]:
    """All pairs in order. With threads > 1 the next left image is decoded and its pyramid built while the caller works on this
    one."""
    check_rig(log)
    if threads <= 1:
        for index in range(len(log)):
            with stopwatch("decode"):
                pair = grey_pair(log, index)
            yield pair
        return
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(_built, log, 0, levels)
        for index in range(len(log)):
            with stopwatch("decode"):
                pair = coming.result()
            if index + 1 < len(log):
                coming = pool.submit(_built, log, index + 1, levels)
            yield pair


def _built(log: DriveLog, index: int, levels: int) -> GreyPair:
    pair = grey_pair(log, index)
    pair.images = pyramid.build(pair.left, levels)
    return pair


def fit_rows(
    log: DriveLog, indices: tuple[int, ...], lens: RightLens = IDENTITY, matches: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """(3,) px: the rows' misalignment from the pairs `indices`, those that the log has, beside what the lens does. matches : what
    `first_matches` gives for them, where it is known already."""
    matches = first_matches(log, indices) if matches is None else matches
    return rows.fit(rows.through_lens(matches, log.rig, lens), displaced(log.rig, lens))


def first_matches(log: DriveLog, indices: tuple[int, ...]) -> NDArray[np.float64]:
    """Stereo matches (n, 4) as of `rows.row_matches` in the pairs `indices`, those that the log has.

    Raises as `check_rig`, and LogError where pixels match only if left and right change places.
    """
    check_rig(log)
    pairs = usable_pairs(log, [index for index in indices if index < len(log)])
    found = [rows.row_matches(left, right) for left, right in pairs]
    matches, exchanged = np.concatenate([np.zeros((0, 4)), *found]), 0
    for k, (left, right) in enumerate(pairs):
        exchanged += len(rows.row_matches(right, left))
        if exchanged < sum(map(len, found[: k + 1])):  # one pair tells, unless it shows nothing
            break
    if exchanged > EXCHANGED_LEAST and exchanged > EXCHANGED_FACTOR * len(matches):
        what = f"left and right images are exchanged: {len(matches)} pixels match as they are, {exchanged} the other way round"
        raise LogError(what, file=log.path, remedy="give the left camera's images as the left ones")
    return matches


def usable_pairs(log: DriveLog, indices: Sequence[int]) -> list[tuple[Image, Image]]:
    """The pairs `indices` without those that cannot be decoded: whether a drive can do without them is for others to say.

    Raises the first one's LogError where none is left.
    """
    pairs, refused = [], None
    for index in indices:
        try:
            pair = grey_pair(log, index)
            pairs.append((pair.left, pair.right))
        except LogError as problem:
            refused = refused or problem
    if refused is not None and not pairs:
        raise refused
    return pairs
