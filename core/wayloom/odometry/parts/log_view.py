"""View of a drive log's frames from one to another, as a drive log of its own."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.types import DriveLog, StereoFrame


class LogView:
    """Frames first to stop - 1 of a log, counted from 0; everything else is the log's."""

    def __init__(self, log: DriveLog, first: int, stop: int) -> None:
        self._log, self._first = log, first
        self.path, self.format, self.name, self.root, self.files = log.path, log.format, log.name, log.root, log.files
        self.rig, self.rig_id, self.vehicle_id, self.colour = log.rig, log.rig_id, log.vehicle_id, log.colour
        self.gnss, self.imu, self.p_cam_gnss, self.T_cam_imu = log.gnss, log.imu, log.p_cam_gnss, log.T_cam_imu
        self.missing, self.receiver = log.missing, log.receiver
        self.t_ns = log.t_ns[first:stop]
        self.truth = None if log.truth is None else log.truth[first:stop]

    def __len__(self) -> int:
        return len(self.t_ns)

    def frame(self, index: int) -> StereoFrame:
        """As of the log."""
        return replace(self._log.frame(self._first + index), index=index)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[StereoFrame]:
        """As of the log."""
        for index in range(*slice(start, stop).indices(len(self))):
            yield self.frame(index)


class GreyLogView(LogView):
    """The view of a log that gives one grey side at a time, which is faster."""

    def grey_side(self, index: int, right: bool) -> NDArray[np.uint8]:
        """(h, w) as of the log."""
        read = type(self._log).grey_side  # type: ignore[attr-defined]
        side: NDArray[np.uint8] = read(self._log, self._first + index, right)
        return side


def log_view(log: DriveLog, first: int, stop: int) -> LogView:
    """The view of frames first to stop - 1."""
    return (GreyLogView if hasattr(type(log), "grey_side") else LogView)(log, first, stop)
