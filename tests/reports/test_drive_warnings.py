"""Warnings of a drive by the facts that its stages noted."""

import pytest

from wayloom.reports.drive_warnings import noted_warnings
from wayloom.reports.served_drive import render

TRACKED = {"frames": 10, "frames_tracked": 10, "segments": 1}


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


def test_a_calibration_that_is_off_is_told_wherever_warnings_are() -> None:
    own = {"used": True, "moves_px": 0.6}
    (warning,) = noted_warnings({"odometry": TRACKED | {"rows_off_px": 0.4, "disparity_bias_px": 0.1, "self_calibration": own}})
    assert warning.startswith("the calibration is off: the right image by 0.6 px on average; the lens that the drive's own images")
    (warning,) = noted_warnings({"odometry": TRACKED | {"rows_off_px": 1.4, "disparity_bias_px": -0.1}})
    assert "rows of left and right by up to 1.4 px, disparities by 0.1 px" in warning
    assert noted_warnings({"odometry": TRACKED | {"rows_off_px": 0.4, "disparity_bias_px": 0.1}}) == []


def test_a_network_of_simulated_streets_on_photographs_is_told_wherever_warnings_are() -> None:
    flags = ("grey_images_to_a_colour_network", "photographs_to_a_network_of_simulated_streets")
    grey, simulated = noted_warnings({"network": {"name": "wayloom-city", **dict.fromkeys(flags, True)}})
    assert grey == "the images are grey and the network wayloom-city was trained on colour: its labels are less certain"
    assert simulated.startswith("the network wayloom-city knows simulated streets only: its labels of real ones are mostly wrong")
    assert noted_warnings({"network": {"name": "wayloom-city", **dict.fromkeys(flags, False)}}) == []


def test_the_page_of_a_served_drive_has_its_warnings() -> None:
    drive = {"name": "one", "id": "0" * 64, "state": "done", "vehicle_id": None, "quality": None, "stages": [], "facts": {}}
    quality = dict.fromkeys(("fixes", "receiver", "scale", "loops")) | {"bursts": []}
    page = render({**drive, "warnings": ["a gap of <2 s>"]}, quality, {})
    assert "<li>a gap of &lt;2 s&gt;</li>" in page
    assert "Before you trust" not in render({**drive, "warnings": []}, quality, {})


def test_a_single_gap_is_told_as_one() -> None:
    assert noted_warnings({"log": {"frames": {"gaps": [{"seconds": 2.0}]}}}) == ["a gap of 2.00 s in the frames' time stamps"]


def test_fixes_of_another_drive_are_told_and_those_of_a_poor_receiver_are_not() -> None:
    foreign = {"residual_rms_m": [8.0, 8.0, 3.0], "scatter_ratio": {"fixed": 104.9}}
    (warning,) = noted_warnings({"georeference": foreign})
    assert warning == "the fixes do not fit the drive: they lie 11.3 m off its way (root mean square); are they of this drive?"
    assert noted_warnings({"georeference": foreign | {"scatter_ratio": {}}}) == []
    assert noted_warnings({"georeference": foreign | {"residual_rms_m": [0.5, 0.5, 9.0]}}) == []
