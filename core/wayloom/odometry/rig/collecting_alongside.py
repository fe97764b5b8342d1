"""Collection of calibration observations in a thread of its own, beside the odometry that gives them."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Final

from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.odometry.rig.posed_pair import PosedPair

MOST_WAITING: Final = 4
"""Keyframes, each with its images."""


class CollectingAlongside:
    """Observer that tells a collector what it is told, in this order, while the odometry goes on; the collector has it all when
    `on_finish` returns. It gathers the same bytes as if it were told at once.

    What the collector raises is raised by one of the next calls.
    """

    def __init__(self, collector: ObservationCollector) -> None:
        self.collector, self._pool = collector, ThreadPoolExecutor(1)
        self._waiting: deque[Future[None]] = deque()

    def on_interrupt(self) -> None:
        """As an observer of the odometry."""
        self._later(self.collector.interrupt)

    def on_keyframe(self, pair: PosedPair, /) -> None:
        """The pair as it is now: its pose and the right camera's rows go on to change."""
        now = replace(pair, T_cam_world=pair.T_cam_world.copy(), right_rectifier=pair.right_rectifier.frozen())
        self._later(lambda: self.collector.on_keyframe(now))

    def on_adjustment(self, *_: object) -> None:
        """Not looked at."""

    def on_frame(self, *_: object) -> None:
        """Not looked at."""

    def on_finish(self, *_: object) -> None:
        """Wait for all of it."""
        self._later(self.collector.on_finish)
        while self._waiting:
            self._waiting.popleft().result()
        self._pool.shutdown()

    def _later(self, work: Callable[[], None]) -> None:
        while len(self._waiting) >= MOST_WAITING or (self._waiting and self._waiting[0].done()):
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(work))
