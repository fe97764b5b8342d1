"""Calibration observations gathered in a thread of their own: the same bytes, and errors that are heard."""

import time
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from made_rig import LENS, LensLog
from made_street import curve

from wayloom.geometry.camera import StereoRig
from wayloom.geometry.lens import IDENTITY
from wayloom.odometry.observers import Observer
from wayloom.odometry.odometry import track
from wayloom.odometry.rig.calibration_file import save_observations
from wayloom.odometry.rig.calibration_observations import CalibrationObservations, ObservationCollector
from wayloom.odometry.rig.collecting_alongside import CollectingAlongside
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.rig.rows import RightRectifier

LOG = LensLog(curve(30, 0.8, 0.01), lens=LENS)


class SlowCollector(ObservationCollector):
    """Is keyframes behind."""

    def on_keyframe(self, pair: PosedPair, /) -> None:
        time.sleep(0.05)
        super().on_keyframe(pair)


class WaitingCollector(ObservationCollector):
    """Looks at nothing before it may."""

    def __init__(self, rig: StereoRig) -> None:
        super().__init__(rig)
        self.may, self.seen = Event(), list[PosedPair]()

    def on_keyframe(self, pair: PosedPair, /) -> None:
        assert self.may.wait(20)
        self.seen.append(pair)


def gathered(collector: ObservationCollector, observer: Observer) -> CalibrationObservations:
    track(LOG, observers=(observer,))
    return collector.observations(LOG)


def test_it_gathers_the_same_bytes_however_late_it_is(tmp_path: Path) -> None:
    at_once, late = ObservationCollector(LOG.rig), SlowCollector(LOG.rig)
    save_observations(gathered(at_once, at_once), tmp_path / "one.npz")
    save_observations(gathered(late, CollectingAlongside(late)), tmp_path / "two.npz")
    assert at_once.finished
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_what_the_collector_raises_is_raised() -> None:
    class Failing(ObservationCollector):
        def on_keyframe(self, pair: PosedPair, /) -> None:
            raise OSError(f"keyframe {pair.frame}")

    with pytest.raises(OSError, match="keyframe 0"):
        track(LOG, observers=(CollectingAlongside(Failing(LOG.rig)),))


def test_a_keyframe_is_seen_as_it_was_told() -> None:
    """Though its pose and the right camera's rows have changed until then."""
    collector, rectifier = WaitingCollector(LOG.rig), RightRectifier(LOG.rig, IDENTITY, np.ones(3))
    alongside, black = CollectingAlongside(collector), np.zeros((4, 4), np.uint8)
    told = PosedPair(7, black, black, np.eye(4), rectifier, 0.25)
    alongside.on_keyframe(told)
    told.T_cam_world[:3, 3] = 5.0
    rectifier.terms = 2.0 * rectifier.terms
    rectifier._renew()
    collector.may.set()
    alongside.on_finish()
    (seen,) = collector.seen
    assert (seen.frame, seen.disparity_bias) == (7, 0.25)
    assert np.array_equal(seen.T_cam_world, np.eye(4))
    assert np.array_equal(seen.right_rectifier.coefficients, np.ones(3))
    pixel = np.array([[40.0, 30.0]])
    assert not np.array_equal(seen.right_rectifier.real_pixels(pixel), rectifier.real_pixels(pixel))
