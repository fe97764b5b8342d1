"""How pairs come from a log to the odometry: checked, decoded ahead where threads allow, and a few of them for the rows' fit."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.geometry.lens import IDENTITY, RightLens, displaced
from wayloom.logs.types import DriveLog, StereoFrame
from wayloom.odometry import pyramid, rows
from wayloom.odometry.stopwatch import Stopwatch

SMALLEST_SIDE = 64
EXCHANGED_LEAST, EXCHANGED_FACTOR = 200, 5  # over four pairs, right drives: 1000 to 5000 in order, 40 to 170 exchanged


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """OpenCV works in the calling thread only, as before afterwards."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def checked_frame(log: DriveLog, index: int) -> StereoFrame:
    """Pair `index` of the log; raises LogError where it does not have the rig's size."""
    frame, camera = log.frame(index), log.rig.camera
    for side, image in (("left", frame.left), ("right", frame.right)):
        if image.shape[:2] != (camera.height, camera.width):
            raise LogError(
                f"the {side} image has {image.shape[1]}x{image.shape[0]} px, the calibration {camera.width}x{camera.height}",
                file=log.path, record=f"frame {index}", remedy="give the calibration of these images",
            )  # fmt: skip
    return frame


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


def frames(log: DriveLog, threads: int, stopwatch: Stopwatch) -> Iterator[StereoFrame]:
    """All pairs in order. With threads > 1 the next pair is decoded while the caller works on this one."""
    check_rig(log)
    if threads <= 1:
        for index in range(len(log)):
            with stopwatch("decode"):
                frame = checked_frame(log, index)
            yield frame
        return
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(checked_frame, log, 0)
        for index in range(len(log)):
            with stopwatch("decode"):
                frame = coming.result()
            if index + 1 < len(log):
                coming = pool.submit(checked_frame, log, index + 1)
            yield frame


def fit_rows(log: DriveLog, indices: tuple[int, ...], lens: RightLens = IDENTITY) -> NDArray[np.float64]:
    """(3,) px: the rows' misalignment from the pairs `indices`, those that the log has, beside what the lens does."""
    return rows.fit(rows.through_lens(first_matches(log, indices), log.rig, lens), displaced(log.rig, lens))


def first_matches(log: DriveLog, indices: tuple[int, ...]) -> NDArray[np.float64]:
    """Stereo matches (n, 4) as of `rows.row_matches` in the pairs `indices`, those that the log has.

    Raises as `check_rig`, and LogError where pixels match only if left and right change places.
    """
    check_rig(log)
    frames = [checked_frame(log, index) for index in indices if index < len(log)]
    pairs = [(pyramid.grey(frame.left), pyramid.grey(frame.right)) for frame in frames]
    matches = np.concatenate([np.zeros((0, 4)), *(rows.row_matches(left, right) for left, right in pairs)])
    exchanged = sum(len(rows.row_matches(right, left)) for left, right in pairs)
    if exchanged > EXCHANGED_LEAST and exchanged > EXCHANGED_FACTOR * len(matches):
        what = f"left and right images are exchanged: {len(matches)} pixels match as they are, {exchanged} the other way round"
        raise LogError(what, file=log.path, remedy="give the left camera's images as the left ones")
    return matches
