"""Registration between made drives: where they meet, how well, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from loops.made_drives import cameras, there
from registration.made_streets import made_street
from stitching.made_placed_drives import FRAME, errors_of, made_drive
from wayloom.errors import StageError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.meetings import find_meetings
from wayloom.stitching.placed_drive import PlacedDrive

BACK = cameras(np.arange(150.0, 40.0, -2.0), -1.8, -1.0)


def test_two_drives_of_one_street_meet_with_an_honest_covariance() -> None:
    street = made_street(0)
    one, other = there(30.0, 130.0), there(60.0, 170.0)
    a, b = made_drive("a", street, one, 1), made_drive("b", street, other, 2)
    found = find_meetings(a, b)
    assert found.meetings
    for meeting in found.meetings:
        assert (meeting.drive_a, meeting.drive_b) == ("a", "b")
        metres, chi2 = errors_of(meeting, one, other)
        assert metres < 0.3
        assert chi2 < 22.5  # 999 of 1000


def test_drives_in_opposite_directions_meet() -> None:
    street, one = made_street(3), there(30.0, 130.0)
    a, b = made_drive("a", street, one, 3), made_drive("b", street, BACK, 4)
    found = find_meetings(a, b)
    assert found.meetings
    for meeting in found.meetings:
        metres, chi2 = errors_of(meeting, one, BACK)
        assert metres < 0.4
        assert chi2 < 22.5


def test_the_order_in_which_drives_are_named_does_not_matter() -> None:
    street = made_street(0)
    a, b = made_drive("a", street, there(30.0, 100.0), 1), made_drive("b", street, there(60.0, 130.0), 2)
    one, other = find_meetings(a, b), find_meetings(b, a)
    assert one.report == other.report
    assert [m.T_a_b.tobytes() + m.covariance.tobytes() for m in one.meetings] == [
        m.T_a_b.tobytes() + m.covariance.tobytes() for m in other.meetings
    ]


def test_streets_that_are_different_do_not_meet_where_places_say_they_are_one() -> None:
    a = made_drive("a", made_street(10), there(30.0, 130.0), 1)
    b = made_drive("b", made_street(11), there(30.0, 130.0), 2)
    found = find_meetings(a, b)
    assert found.meetings == ()
    assert found.report["tried"] > 0
    assert sum(found.report["refused"].values()) + sum(found.report["refused_together"].values()) >= found.report["tried"]


def test_drives_far_apart_are_not_compared_at_all() -> None:
    street = made_street(0, blocks=8)
    a, b = made_drive("a", street, there(30.0, 90.0), 1), made_drive("b", street, there(300.0, 360.0), 2)
    assert find_meetings(a, b).report["tried"] == 0


def test_a_drive_without_gnss_is_joined_where_it_overlaps_a_hundred_metres() -> None:
    street, one, other = made_street(5), there(30.0, 170.0), there(60.0, 160.0)
    a, b = made_drive("a", street, one, 1), made_drive("b", street, other, 2, located=False)
    found = find_meetings(a, b)
    assert found.meetings
    for meeting in found.meetings:
        metres, chi2 = errors_of(meeting, one, other)
        assert metres < 0.3
        assert chi2 < 22.5


def test_blocks_that_look_alike_do_not_tell_where_a_drive_without_gnss_is() -> None:
    street = made_street(7, blocks=4, alike=True)
    a = made_drive("a", street, there(30.0, 200.0), 1)
    b = made_drive("b", street, there(80.0, 160.0), 2, located=False)
    found = find_meetings(a, b)
    assert found.meetings == ()


def test_what_cannot_be_compared_is_refused_with_the_reason() -> None:
    street = made_street(0)
    a = made_drive("a", street, there(30.0, 60.0), 1)
    with pytest.raises(StageError, match="compared with itself"):
        find_meetings(a, a)
    elsewhere = tuple(replace(item, drive_id="b", frame=MapFrame(9.0, 48.0, FRAME.height_m)) for item in a.submaps)
    with pytest.raises(StageError, match="one frame"):
        find_meetings(a, PlacedDrive("b", a.places, elsewhere))
    with pytest.raises(StageError, match="run the stages places"):
        PlacedDrive("b", a.places, ())
