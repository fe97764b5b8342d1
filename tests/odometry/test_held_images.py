"""Images that are looked at twice are decoded once, as far as there is room; nothing else of a log changes."""

import numpy as np
import pytest
from made_street import CountingLog, MadeLog, curve

from wayloom.calibration.self_calibration import track_calibrated
from wayloom.odometry import held_images
from wayloom.odometry.settings import OdometrySettings

FRAMES = 60


@pytest.mark.parametrize("threads", [1, 2])
def test_a_drive_that_learns_its_lens_decodes_each_image_once(threads: int) -> None:
    log = CountingLog(curve(FRAMES))
    settings = OdometrySettings(self_calibration=True)
    held = track_calibrated(log, settings, threads=threads)
    assert set(log.decoded.values()) == {1}
    assert {(index, False) for index in range(FRAMES)} <= set(log.decoded)
    plain = track_calibrated(MadeLog(curve(FRAMES)), settings)
    np.testing.assert_array_equal(held.trajectory.T_world_cam, plain.trajectory.T_world_cam)


def test_no_more_is_held_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    log = CountingLog(curve(4))
    monkeypatch.setattr(held_images, "MOST_BYTES", 2 * log.rig.camera.width * log.rig.camera.height)
    held = held_images.HeldImages(log)
    first = [held.grey_side(index, False) for index in range(3)]
    assert held.grey_side(1, False) is first[1]
    assert held.grey_side(2, False) is not first[2]
    held.release()
    assert held.grey_side(0, False) is first[0]
    assert held.grey_side(0, False) is not first[0]
    assert log.decoded == {(0, False): 2, (1, False): 1, (2, False): 2}


def test_a_log_that_gives_pairs_only_is_left_as_it_is() -> None:
    log = MadeLog(curve(2))
    assert held_images.held_images(log) is log
