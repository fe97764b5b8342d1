"""A car that stands for minutes while others drive by and the light changes: it stays where it is and nothing grows."""

import tracemalloc

import numpy as np
import pytest
from made_street import TEXTURES, MadeLog, curve, pair

from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.logs.types import StereoFrame
from wayloom.odometry.odometry import track
from wayloom.odometry.types import OdometryResult

RIG = StereoRig(PinholeCamera(150.0, 150.0, 119.5, 74.5, 240, 150), (-0.5, 0.0, 0.0))
BEFORE, STANDING, AFTER = 12, 1800, 12
PASSING_EVERY, PASSING = 150, 40
"""Frames: 15 s from one bus to the next, each of which takes 4 s to drive through the image."""
LIGHT_PERIOD, LIGHT = 600, 0.25
"""A cloud comes and goes within a minute: the images' gain swings by so much about one."""
NOISE = 2.0


class StandingLog(MadeLog):
    """A drive that stops for three minutes: fresh noise, a bus 6 m ahead that crosses now and then, and clouds."""

    def __init__(self, standing: int = STANDING) -> None:
        places = curve(BEFORE + AFTER)
        super().__init__(np.concatenate([places[:BEFORE], np.tile(places[BEFORE - 1], (standing, 1, 1)), places[BEFORE:]]), rig=RIG)
        self.stop = range(BEFORE, BEFORE + standing)
        self.still = pair(self.truth[BEFORE], RIG)[:2]

    def frame(self, index: int) -> StereoFrame:
        stands = index in self.stop
        images = [image.copy() for image in (self.still if stands else pair(self.truth[index], RIG)[:2])]
        rng = np.random.default_rng(index)
        phase = (index - BEFORE) % PASSING_EVERY - (PASSING_EVERY - PASSING)
        if stands and phase >= 0:
            start = int(-100 + 340 * phase / PASSING)
            for image, disparity in zip(images, (0, 12), strict=True):
                a, b = max(0, start - disparity), min(240, start - disparity + 100)
                if a < b:
                    image[30:110, a:b] = TEXTURES[2][:80, a - start + disparity : b - start + disparity]
        gain = 1.0 + LIGHT * np.sin(2 * np.pi * (index - BEFORE) / LIGHT_PERIOD) if stands else 1.0
        noisy = [gain * image + rng.normal(0.0, NOISE, image.shape) for image in images]
        left, right = (np.clip(np.round(image), 0, 255).astype(np.uint8) for image in noisy)
        return StereoFrame(index, int(self.t_ns[index]), left, right)


Standing = tuple[StandingLog, OdometryResult, list[int]]


@pytest.fixture(scope="module")
def stop() -> Standing:
    """The log, what came out, and the bytes that Python held after each frame."""
    log, held = StandingLog(), []
    tracemalloc.start()
    result = track(log, progress=lambda share, what: held.append(tracemalloc.get_traced_memory()[0]))
    tracemalloc.stop()
    return log, result, held[-len(log) :]


def test_a_car_that_stands_for_minutes_stays_where_it_is(stop: Standing) -> None:
    _, result, _ = stop
    assert result.trajectory.tracked.all()
    assert len(result.report["segments"]) == 1
    places = result.trajectory.T_world_cam[BEFORE : BEFORE + STANDING, :3, 3]
    minute = STANDING // 3
    assert np.linalg.norm(places[-minute:].mean(axis=0) - places[:minute].mean(axis=0)) < 0.001
    assert np.linalg.norm(places - np.median(places, axis=0), axis=1).max() < 0.02  # in images of 240 px with a noise of 2


def test_a_car_that_stands_makes_no_keyframes_but_one_for_the_light_where_it_stopped(stop: Standing) -> None:
    _, result, _ = stop
    assert np.isin(result.keyframes.frame, range(BEFORE, BEFORE + STANDING)).sum() <= 1


def test_memory_does_not_grow_while_a_car_stands_but_for_its_poses(stop: Standing) -> None:
    _, _, held = stop
    growth = held[BEFORE + STANDING - 1] - held[BEFORE + STANDING // 3]
    assert growth < 2000 * (STANDING - STANDING // 3)  # bytes: a pose and its places in lists


def test_a_car_drives_on_after_minutes_as_before(stop: Standing) -> None:
    log, result, _ = stop
    T, last = result.trajectory.T_world_cam, BEFORE + STANDING - 1
    way, truth = (np.linalg.norm(P[-1, :3, 3] - P[last, :3, 3]) for P in (T, log.truth))
    assert way == pytest.approx(truth, rel=0.01)
