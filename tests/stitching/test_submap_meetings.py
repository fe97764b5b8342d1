"""Meetings of submaps from pairs of views."""

from dataclasses import replace

import numpy as np
import pytest

from loops.made_drives import there
from registration.made_streets import made_street
from stitching.made_placed_drives import KEYFRAMES, made_drive
from wayloom.geometry import se3
from wayloom.loops.priors import Closure
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.submap_meetings import drift_within, meeting_of, meetings_of, stretches

SETTINGS = MeetingSettings()
COVARIANCE = np.diag([0.05**2] * 3 + [0.002**2] * 3)


def two_drives() -> tuple[PlacedDrive, PlacedDrive]:
    """Two drives of the same road whose keyframes stand beside each other."""
    street, cameras = made_street(0), there(30.0, 130.0)
    return made_drive("a", street, cameras, 1), made_drive("b", street, cameras, 1)


def beside(a: PlacedDrive, keyframe: int) -> Closure:
    """Both drives' keyframe at one place."""
    return Closure(keyframe, len(a.places) + keyframe, np.eye(4), COVARIANCE)


def test_pairs_become_one_meeting_for_each_two_submaps() -> None:
    a, b = two_drives()
    found = meetings_of(a, b, [beside(a, k) for k in (2, 6, KEYFRAMES + 3)], SETTINGS)
    assert [(m.submap_a, m.submap_b) for m in found] == [(0, 0), (1, 1)]
    for meeting in found:
        np.testing.assert_allclose(meeting.T_a_b, np.eye(4), atol=1e-9)


def test_pairs_that_share_their_views_count_as_one() -> None:
    a, b = two_drives()
    (one,), (thrice,) = (meetings_of(a, b, [beside(a, 15)] * count, SETTINGS) for count in (1, 3))
    np.testing.assert_allclose(thrice.covariance, one.covariance, rtol=1e-9, atol=1e-15)
    (apart,), (near,) = (meetings_of(a, b, [beside(a, 5), beside(a, k)], SETTINGS) for k in (24, 6))
    assert np.linalg.slogdet(apart.covariance)[1] < np.linalg.slogdet(near.covariance)[1]


def test_a_long_road_that_two_submaps_share_is_a_meeting_for_each_stretch_and_together_as_sure_as_one() -> None:
    a, b = two_drives()
    rows = range(3, 28, 3)
    pairs = [beside(a, k) for k in rows]
    found = meetings_of(a, b, pairs[::-1], SETTINGS)
    road_m = a.road[rows[-1]] - a.road[rows[0]]
    assert 40.0 <= road_m < 80.0
    assert [(m.submap_a, m.submap_b) for m in found] == [(0, 0), (0, 0)]
    independent = 1.0 + road_m / SETTINGS.independent_m
    whole = meeting_of(a, b, (0, 0), pairs, SETTINGS, independent)
    counts = [len(part) for part in stretches(a, pairs, SETTINGS)]
    each = [count / (0.5 * independent) * np.linalg.inv(m.covariance) for count, m in zip(counts, found, strict=True)]
    np.testing.assert_allclose(sum(each), len(pairs) / independent * np.linalg.inv(whole.covariance), rtol=1e-6, atol=1e-2)


def test_no_stretch_has_fewer_pairs_than_must_agree() -> None:
    a, _ = two_drives()

    def cut(*keyframes: int) -> list[list[int]]:
        return [[pair.first for pair in part] for part in stretches(a, [beside(a, k) for k in keyframes], SETTINGS)]

    assert cut(28, 3, 5, 27) == [[3, 5], [27, 28]]
    assert cut(3, 4, 5, 28) == [[3, 4, 5, 28]]
    assert cut(3, 26, 27, 28) == [[3, 26, 27, 28]]
    assert cut(7) == [[7]]


def test_the_mean_lies_nearer_to_the_surer_pair() -> None:
    a, b = two_drives()
    off = np.eye(4)
    off[0, 3] = 0.3
    sure = beside(a, 15)
    vague = Closure(sure.first, sure.second, off, 100.0 * COVARIANCE)
    assert 0.0 < meeting_of(a, b, (0, 0), [sure, vague], SETTINGS, 1.0).T_a_b[0, 3] < 0.05


def broken(drive: PlacedDrive, by_m: float) -> PlacedDrive:
    """The drive's graph has the first half of its first submap further back than the odometry."""
    first, *others = drive.submaps
    bend = np.zeros((KEYFRAMES, 6))
    bend[: KEYFRAMES // 2, 2] = -by_m
    return replace(drive, submaps=(replace(first, bend=bend), *others))


def test_what_is_measured_beyond_a_break_of_the_odometry_is_believed_no_more_than_the_drives_graph_bends_there() -> None:
    a, b = two_drives()
    whole = meeting_of(a, b, (0, 0), [beside(a, 3)], SETTINGS, 1.0)
    for one, other in ((broken(a, 1.5), b), (a, broken(b, 1.5))):
        beyond = meeting_of(one, other, (0, 0), [beside(a, 3)], SETTINGS, 1.0)
        np.testing.assert_allclose(beyond.T_a_b, whole.T_a_b, atol=1e-9)
        more = beyond.covariance - whole.covariance
        assert np.sqrt(more[2, 2]) == pytest.approx(1.5, rel=0.02)
        here = meeting_of(one, other, (0, 0), [beside(a, 20)], SETTINGS, 1.0)
        np.testing.assert_allclose(here.covariance, meeting_of(a, b, (0, 0), [beside(a, 20)], SETTINGS, 1.0).covariance)


def test_drift_grows_with_the_way_and_is_stated_at_its_end() -> None:
    def end_sigma_m(way_m: float) -> float:
        T = np.eye(4)
        T[2, 3] = way_m
        J = np.concatenate([np.eye(3), -se3.hat(T[:3, 3])], axis=1)
        return float(np.sqrt((J @ drift_within(T, SETTINGS) @ J.T)[0, 0]))

    assert drift_within(np.eye(4), SETTINGS).max() == 0.0
    np.testing.assert_allclose([end_sigma_m(10.0), end_sigma_m(40.0)], SETTINGS.drift_share * np.array([10.0, 40.0]), rtol=1e-9)
