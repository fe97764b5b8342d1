"""Warnings of a drive by the facts that its stages noted."""

import pytest

from wayloom.reports.drive_warnings import noted_warnings


def test_a_scale_of_three_per_cent_is_warned_of_and_one_of_one_is_not() -> None:
    (warning,) = noted_warnings({"georeference": {"scale": {"mean": 1.03, "sigma": 0.002}}})
    assert "disagree on the length of the drive by +3.0 %" in warning
    assert noted_warnings({"georeference": {"scale": {"mean": 1.01, "sigma": 0.002}}}) == []


@pytest.mark.parametrize("facts", [{}, {"log": None, "georeference": None}, {"georeference": {"scale": None, "messages": []}}])
def test_of_a_drive_of_which_nothing_is_known_nothing_is_warned_of(facts: dict[str, object]) -> None:
    assert noted_warnings(facts) == []


def test_lost_frames_come_first_then_what_the_log_lacks() -> None:
    odometry = {"frames": 100, "frames_tracked": 90, "segments": 2, "losses": [{"frame": 7, "reason": "too dark"}]}
    log = {"missing": ["IMU", "lever arm"], "frames": {"gaps": [{"seconds": 0.5}, {"seconds": 2.0}]}}
    found = noted_warnings({"odometry": odometry, "georeference": {"messages": ["only 5 fixes"]}, "log": log})
    assert found[0].startswith("10 of 100 frames were lost (first frame 7: too dark)")
    assert found[1:] == ["only 5 fixes", "not in the log: lever arm", "2 gaps in the frames' time stamps, the longest 2.00 s"]
