"""Meetings of submaps from pairs of views."""

import numpy as np

from loops.made_drives import there
from registration.made_streets import made_street
from stitching.made_placed_drives import KEYFRAMES, made_drive
from wayloom.geometry import se3
from wayloom.loops.priors import Closure
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.submap_meetings import drift_within, meeting_of, meetings_of

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
    one = meeting_of(a, b, (0, 0), [beside(a, 15)], SETTINGS)
    thrice = meeting_of(a, b, (0, 0), [beside(a, 15)] * 3, SETTINGS)
    np.testing.assert_allclose(thrice.covariance, one.covariance, rtol=1e-9, atol=1e-15)
    apart = meeting_of(a, b, (0, 0), [beside(a, 5), beside(a, 25)], SETTINGS)
    near = meeting_of(a, b, (0, 0), [beside(a, 5), beside(a, 6)], SETTINGS)
    assert np.linalg.slogdet(apart.covariance)[1] < np.linalg.slogdet(near.covariance)[1]


def test_the_mean_lies_nearer_to_the_surer_pair() -> None:
    a, b = two_drives()
    off = np.eye(4)
    off[0, 3] = 0.3
    sure = beside(a, 15)
    vague = Closure(sure.first, sure.second, off, 100.0 * COVARIANCE)
    assert 0.0 < meeting_of(a, b, (0, 0), [sure, vague], SETTINGS).T_a_b[0, 3] < 0.05


def test_drift_grows_with_the_way_and_is_stated_at_its_end() -> None:
    def end_sigma_m(way_m: float) -> float:
        T = np.eye(4)
        T[2, 3] = way_m
        J = np.concatenate([np.eye(3), -se3.hat(T[:3, 3])], axis=1)
        return float(np.sqrt((J @ drift_within(T, SETTINGS) @ J.T)[0, 0]))

    assert drift_within(np.eye(4), SETTINGS).max() == 0.0
    np.testing.assert_allclose([end_sigma_m(10.0), end_sigma_m(40.0)], SETTINGS.drift_share * np.array([10.0, 40.0]), rtol=1e-9)
