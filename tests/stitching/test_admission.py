"""Admission of guests: by meetings that are believed, alone against the drives that are in, whatever order all come in."""

import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.config.gate import gate_of
from wayloom.geometry import se3
from wayloom.stitching.admission import ALONE, UNKNOWN, Verdict, admit
from wayloom.stitching.drive_chain import own_covariance
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import City, DrivePlaces, Meeting

FloatArray = NDArray[np.float64]
SETTINGS = CityGraphSettings()
LENGTH_M = 75.0
RTK_M, SINGLE_M = 0.03, 2.0
MEASURED = np.diag([0.05**2] * 3 + [np.radians(0.1) ** 2] * 3)


def road(first: int, last: int) -> FloatArray:
    """(n, 4, 4) the true places of submaps along the x axis."""
    T = np.tile(np.eye(4), (last - first, 1, 1))
    T[:, 0, 3] = LENGTH_M * np.arange(first, last)
    return T


def drive(name: str, first: int, last: int, sigma_m: float, off_m: float = 0.0) -> DrivePlaces:
    """A drive along the road, placed off_m beside its true place."""
    T = road(first, last)
    at = se3.adjoint(se3.from_rotation_translation(np.tile(np.eye(3), (len(T), 1, 1)), T[:, :3, 3]))
    local = np.diag([sigma_m**2] * 3 + [np.radians(0.2) ** 2] * 3)
    covariance = at @ local @ np.swapaxes(at, 1, 2)
    T[:, 1, 3] += off_m
    return DrivePlaces(name, T, covariance, np.full(len(T), LENGTH_M), np.ones(len(T) - 1, np.bool_))


def loose(name: str, first: int, last: int) -> DrivePlaces:
    """The same without GNSS, in a frame of its own."""
    T = se3.inverse(road(first, last)[0]) @ road(first, last)
    length_m = np.full(len(T), LENGTH_M)
    return DrivePlaces(name, T, own_covariance(T, length_m, SETTINGS), length_m, np.ones(len(T) - 1, np.bool_), located=False)


def meet(a: str, b: str, pairs: list[tuple[int, int]], shift_m: float = 0.0) -> list[Meeting]:
    """Meetings of submaps at these places of the road; shift_m : where they put b against a, elsewhere than in truth."""
    starts = {one: int(one.split("@")[1]) for one in (a, b)}
    found = []
    for at_a, at_b in pairs:
        T = np.eye(4)
        T[0, 3] = LENGTH_M * (at_b - at_a) + shift_m
        found.append(Meeting(a, at_a - starts[a], b, at_b - starts[b], T, MEASURED))
    return found


def asked(members: list[DrivePlaces], guests: list[DrivePlaces], meetings: list[Meeting]) -> tuple[City, dict[str, Verdict]]:
    return admit(members, guests, meetings, SETTINGS, lambda grade: gate_of(grade) == "merge")


def test_a_guest_that_bridges_two_members_comes_in_and_moves_them_no_more_than_it_may() -> None:
    members = [drive("a@0", 0, 3, RTK_M), drive("b@5", 5, 8, RTK_M)]
    guest = drive("g@1", 1, 7, SINGLE_M, off_m=1.5)
    meetings = meet("a@0", "g@1", [(1, 1), (2, 2)]) + meet("b@5", "g@1", [(5, 5), (6, 6)])
    city, verdicts = asked(members, [guest], meetings)
    verdict = verdicts["g@1"]
    assert (verdict.admitted, verdict.meetings, verdict.drives) == (True, 4, ("a@0", "b@5"))
    assert verdict.reason == f"placed by 4 meetings with 2 drives, sigma {verdict.sigma_m:.2f} m"
    assert np.abs(city.drives["g@1"].T_map_submap[:, 1, 3]).max() < 0.3
    assert np.abs(city.drives["a@0"].T_map_submap[:, 1, 3]).max() < 0.05


def test_neither_the_order_of_drives_nor_that_of_meetings_changes_a_bit() -> None:
    members = [drive("a@0", 0, 3, RTK_M), drive("b@5", 5, 8, RTK_M)]
    guests = [drive("g@1", 1, 7, SINGLE_M, 1.5), drive("h@6", 6, 12, SINGLE_M, -1.0), loose("n@8", 8, 12)]
    meetings = meet("a@0", "g@1", [(1, 1), (2, 2)]) + meet("g@1", "h@6", [(6, 6)]) + meet("b@5", "h@6", [(6, 6), (7, 7)])
    meetings += meet("h@6", "n@8", [(8, 8), (9, 9), (10, 10)])
    city, verdicts = asked(members, guests, meetings)
    assert [verdicts[one.drive_id].admitted for one in guests] == [True, True, True]
    again, same = asked(members[::-1], guests[::-1], meetings[::-1])
    assert same == verdicts
    for name, one in city.drives.items():
        assert one.T_map_submap.tobytes() == again.drives[name].T_map_submap.tobytes()
        assert one.covariance.tobytes() == again.drives[name].covariance.tobytes()


def test_guests_that_meet_each_other_alone_stay_outside_and_so_does_one_whose_grade_the_gate_holds() -> None:
    twins = [drive("g@0", 0, 4, SINGLE_M), drive("h@0", 0, 4, SINGLE_M)]
    both = meet("g@0", "h@0", [(0, 0), (1, 1), (2, 2)])
    city, verdicts = asked([], twins, both)
    assert verdicts == {"g@0": Verdict(False, ALONE), "h@0": Verdict(False, ALONE)}
    assert city.drives == {}
    released = drive("m@0", 0, 4, SINGLE_M)
    _, verdicts = asked([released], twins, meet("m@0", "g@0", [(0, 0), (1, 1)]))
    assert verdicts["g@0"].reason.endswith("grade D is not merged")
    assert verdicts["h@0"] == Verdict(False, ALONE)


@pytest.mark.parametrize(("sigma_m", "off_m"), [(0.3, 5.0), (1.5, 30.0)])
def test_a_guest_sure_of_a_wrong_place_stays_outside_and_the_city_is_the_one_without_it(sigma_m: float, off_m: float) -> None:
    members = [drive("a@0", 0, 4, RTK_M), drive("b@0", 0, 4, RTK_M)]
    between = meet("a@0", "b@0", [(0, 0), (2, 2)])
    alone, _ = asked(members, [], between)
    liar = drive("g@0", 0, 4, sigma_m, off_m)
    city, verdicts = asked(members, [liar], between + meet("a@0", "g@0", [(0, 0), (1, 1), (2, 2)]))
    assert not verdicts["g@0"].admitted
    assert verdicts["g@0"].reason == "3 of its 3 meetings are contradicted by its own place or by other drives"
    for name, one in alone.drives.items():
        assert one.T_map_submap.tobytes() == city.drives[name].T_map_submap.tobytes()


def test_one_meeting_places_nobody() -> None:
    members = [drive("a@0", 0, 4, RTK_M)]
    _, verdicts = asked(members, [drive("g@0", 0, 4, SINGLE_M), loose("n@0", 0, 4)], meet("a@0", "g@0", [(1, 1)]))
    assert verdicts["g@0"] == Verdict(False, "1 meeting with the map: 2 must agree")
    assert verdicts["n@0"] == Verdict(False, UNKNOWN)


def test_two_stretches_of_one_submaps_road_place_a_drive_where_they_agree_and_not_where_they_do_not() -> None:
    members, guest = [drive("a@0", 0, 4, RTK_M)], drive("g@3", 3, 7, SINGLE_M, 1.5)
    first, agreeing, denying = (meet("a@0", "g@3", [(3, 3)], shift_m)[0] for shift_m in (0.0, 0.05, 1.0))
    city, verdicts = asked(members, [guest], [first, agreeing])
    assert verdicts["g@3"].admitted
    assert np.linalg.norm(city.drives["g@3"].T_map_submap[0, :3, 3] - [3 * LENGTH_M, 0.0, 0.0]) < 0.1
    assert asked(members, [guest], [first, denying])[1]["g@3"] == Verdict(False, "1 meeting with the map: 2 must agree")
    assert not asked(members, [loose("n@3", 3, 7)], meet("a@0", "n@3", [(3, 3), (3, 3)]))[1]["n@3"].admitted


def test_a_drive_without_gnss_needs_meetings_over_enough_road_and_none_that_puts_it_elsewhere() -> None:
    members = [drive("a@0", 0, 5, RTK_M), drive("b@0", 0, 5, RTK_M), drive("c@20", 20, 24, RTK_M)]
    guest = loose("n@0", 0, 5)
    short = meet("a@0", "n@0", [(1, 1)]) + meet("b@0", "n@0", [(1, 1)])
    assert asked(members, [guest], short)[1]["n@0"].reason == "its meetings agree over 75 m of road only: 100 m must"
    enough = short + meet("a@0", "n@0", [(2, 2), (3, 3)])
    assert asked(members, [guest], enough)[1]["n@0"].admitted
    elsewhere = meet("c@20", "n@0", [(21, 2)])
    elsewhere[0] = Meeting("c@20", 1, "n@0", 2, np.eye(4), MEASURED)
    verdict = asked(members, [guest], enough + elsewhere)[1]["n@0"]
    assert not verdict.admitted
    assert verdict.reason == "it fits drive a@0 and drive c@20 at places 1425 m apart: streets look alike"


def test_guests_that_fit_alone_but_contradict_each_other_do_not_come_together() -> None:
    """Each is weakly tied to the map, and firmly to the other, where it cannot be."""
    members = [drive("a@0", 0, 3, RTK_M), drive("b@9", 9, 12, RTK_M)]
    guests = [drive("g@0", 0, 6, SINGLE_M), drive("h@6", 6, 12, SINGLE_M)]
    meetings = meet("a@0", "g@0", [(0, 0), (1, 1)]) + meet("b@9", "h@6", [(9, 9), (10, 10)])
    apart, _ = asked(members, guests, meetings)
    city, verdicts = asked(members, guests, meetings + meet("g@0", "h@6", [(5, 6), (4, 6), (3, 6)], shift_m=25.0))
    for name, verdict in verdicts.items():
        assert verdict.admitted == (name in city.drives)
    assert not all(verdict.admitted for verdict in verdicts.values())
    assert apart.drives.keys() == {"a@0", "b@9", "g@0", "h@6"}
