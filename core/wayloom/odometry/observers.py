"""Observers of the odometry: what debugging and calibration are told while a drive is tracked."""

from collections.abc import Callable
from typing import Protocol

from wayloom.odometry.mapper import Mapper
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.tracker import Tracker
from wayloom.odometry.tracking.frame import GreyPair
from wayloom.odometry.tracking.frame_status import FrameStatus


class Observer(Protocol):
    """Told by `track`, for each frame in this order; it may look at everything and must change nothing."""

    def on_adjustment(self, mapper: Mapper, /) -> None:
        """The window, with its new keyframe and points, is about to be adjusted."""

    def on_interrupt(self, /) -> None:
        """The window was given up: what comes does not join on to what was."""

    def on_keyframe(self, pair: PosedPair, /) -> None:
        """The frame has become a keyframe, its window adjusted."""

    def on_frame(self, pair: GreyPair, status: FrameStatus, tracker: Tracker, mapper: Mapper, /) -> None:
        """A frame is done."""

    def on_finish(self, mapper: Mapper, /) -> None:
        """The drive is done."""


class KeyframeCaller:
    """Observer that calls a function with the frame of each keyframe."""

    def __init__(self, call: Callable[[int], None]) -> None:
        self._call = call

    def on_keyframe(self, pair: PosedPair, /) -> None:
        """The frame has become a keyframe."""
        self._call(pair.frame)

    def on_adjustment(self, *_: object) -> None:
        """Not looked at."""

    def on_interrupt(self) -> None:
        """Not looked at."""

    def on_frame(self, *_: object) -> None:
        """Not looked at."""

    def on_finish(self, *_: object) -> None:
        """Not looked at."""
