"""Pieces of a drive give the evidence that whole drives give, whatever their speed, and whatever they do not show."""

import numpy as np
import pytest
from made_street import CountingLog, MadeLog, curve

from wayloom.calibration.sampling import Sampler
from wayloom.geometry import se3
from wayloom.geometry.lens import IDENTITY
from wayloom.logs.types import StereoFrame
from wayloom.odometry import frame_source
from wayloom.odometry.rig.calibration_observations import ANGLES_RAD, DISTANCES_M, CalibrationObservations, ObservationCollector
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.settings import OdometrySettings


class Damaged(MadeLog):
    """Frames 6 and 7 are black."""

    def frame(self, index: int) -> StereoFrame:
        frame = super().frame(index)
        if index in (6, 7):
            frame.left[:], frame.right[:] = 0, 0
        return frame


def sampled(log: MadeLog, wanted: int = 4) -> CalibrationObservations:
    right_rectifier = RightRectifier(log.rig, IDENTITY, frame_source.fit_rows(log, (0,)))
    collector = ObservationCollector(log.rig)
    Sampler(log, OdometrySettings(), right_rectifier, collector).go_on(iter(range(len(log))), wanted)
    return collector.observations(log)


@pytest.mark.parametrize("step_m", [0.4, 0.8, 1.6])
def test_hosts_and_targets_are_as_far_apart_as_wanted_at_any_speed(step_m: float) -> None:
    log = MadeLog(curve(24, step_m, 0.01))
    found = sampled(log, 3)
    assert found.groups == 3
    hosts = log.truth[found.host_frame][:, :3, 3]
    assert np.linalg.norm(np.diff(hosts, axis=0), axis=1).min() > 0.95 * DISTANCES_M[-1]
    for host, targets, T_found in zip(found.host_frame, found.target_frame, found.T_target_host, strict=True):
        assert targets[0] > host
        for k, target in enumerate(targets[targets >= 0]):
            T = se3.inverse(log.truth[target]) @ log.truth[host]
            assert np.linalg.norm(T[:3, 3]) > 0.95 * DISTANCES_M[k] or np.linalg.norm(se3.log(T)[3:]) > 0.95 * ANGLES_RAD[k]
            error = se3.log(T_found[k] @ se3.inverse(T))
            assert np.linalg.norm(error[:3]) < 0.05 * max(step_m, DISTANCES_M[k])
            assert np.linalg.norm(error[3:]) < 0.01


def test_a_match_group_does_not_reach_over_what_was_not_seen() -> None:
    found = sampled(Damaged(curve(20, 0.8)))
    assert found.groups >= 3
    both = np.column_stack([found.host_frame, found.target_frame])
    assert not np.isin(both, (6, 7)).any()
    assert not ((both.min(axis=1, initial=99, where=both >= 0) < 6) & (both.max(axis=1) > 7)).any()


def test_a_car_that_stands_gives_nothing() -> None:
    assert sampled(MadeLog(curve(12, 0.0))).groups == 0


def test_of_a_car_that_stands_or_creeps_few_frames_are_looked_at_and_what_they_show_is_right() -> None:
    way = curve(16, 0.8, 0.01)
    stands, creeps = np.concatenate([np.repeat(way[:1], 40, axis=0), way]), curve(80, 0.1, 0.003)
    for truth, most in ((stands, 10 + 16), (creeps, 2 + 80 // 4)):
        log = CountingLog(truth)
        found = sampled(log, 2)
        assert found.groups == 2
        assert len({index for index, _ in log.decoded}) <= most
        for host, targets, T_found in zip(found.host_frame, found.target_frame, found.T_target_host, strict=True):
            for target, T in zip(targets[targets >= 0], T_found, strict=False):
                error = se3.log(T @ se3.inverse(se3.inverse(log.truth[target]) @ log.truth[host]))
                assert np.linalg.norm(error[:3]) < 0.05
                assert np.linalg.norm(error[3:]) < 0.01
