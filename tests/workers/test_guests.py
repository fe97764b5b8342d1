"""Drives that are held for their place alone: their meetings with the map's drives place them, or they stay outside."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from loops.made_drives import there
from registration.made_streets import BLOCK_M, made_street
from stitching.made_placed_drives import RTK, made_drive
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.store import drives, gate, maps
from wayloom_workers.stage_hooks import WorkerContext
from workers.conftest import NewService
from workers.test_city_alignment import add, places
from workers.test_stitching import published

STREET = made_street(0)
WAYS = {"one": there(30.0, 130.0), "two": there(60.0, 170.0), "single": there(40.0, 150.0), "none": there(20.0, 150.0)}
FAR = there(190.0, 270.0)
GRADES = {"one": "A", "two": "A", "single": "D", "none": None}


@pytest.fixture(scope="module")
def made() -> dict[str, PlacedDrive]:
    members = {name: made_drive(name, STREET, WAYS[name], seed, gnss=RTK) for name, seed in (("one", 1), ("two", 2))}
    single = made_drive("single", STREET, WAYS["single"], 3)
    return members | {"single": single, "none": made_drive("none", STREET, WAYS["none"], 4, located=False)}


def arrive(context: WorkerContext, made: dict[str, PlacedDrive], names: Sequence[str]) -> dict[str, str]:
    return {name: add(context, made[name], GRADES[name]) for name in names}


def said(context: WorkerContext, drive_id: str) -> tuple[str, bool, str]:
    """State of a drive, whether it was admitted, and the reason."""
    with context.database.read() as session:
        drive = drives.get(session, drive_id)
        return drive.state, drive.admitted, (drive.map_verdict or {}).get("reason", "")


def off_m(context: WorkerContext, drive: PlacedDrive, name: str) -> float:
    """m rms: by how much the drive's anchors lie elsewhere than in truth."""
    anchors = [int(item.submap.keyframe_frame[len(item.submap.keyframe_frame) // 2]) for item in drive.submaps]
    return float(np.sqrt(((places(context)[name][:, :3, 3] - WAYS[name][anchors, :3, 3]) ** 2).sum(axis=1).mean()))


def test_a_drive_without_corrections_enters_by_its_meetings_in_every_order_of_arrival_alike(
    context: WorkerContext, new_service: NewService, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    ids = arrive(context, made, ("one", "two", "single"))
    at_once = published(context, tmp_path / "1")
    state, admitted, reason = said(context, ids["single"])
    assert (state, admitted) == ("done", True)
    assert re.fullmatch(r"placed by \d+ meetings with 2 drives, sigma 0\.\d\d m", reason)
    assert off_m(context, made["single"], "single") < 0.3
    assert at_once["drives"] == sorted(ids.values())

    other = new_service(tmp_path / "other")
    ended = ""
    for name in ("single", "two", "one"):
        arrive(other, made, (name,))
        one_by_one = published(other, tmp_path / f"2{name}")
        ended += said(other, ids["single"])[0][0]
    assert ended[0] == "h"
    assert ended[-1] == "d"
    assert one_by_one == at_once
    assert said(other, ids["single"]) == (state, admitted, reason)


def test_a_guest_leaves_with_the_drives_that_placed_it_and_the_map_is_as_if_it_had_never_come(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    own = made["single"].submaps[0].T_enu_submap
    far = add(context, made_drive("far", STREET, FAR, 5, gnss=RTK))
    alone = published(context, tmp_path / "1")
    ids = arrive(context, made, ("one", "two", "single"))
    published(context, tmp_path / "2")
    assert said(context, ids["single"])[1]
    for count, name in enumerate(("one", "two")):
        with context.database.write() as session:
            drives.request_removal(session, ids[name])
            drives.delete_rows(session, ids[name])
        after = published(context, tmp_path / f"3{count}")
    assert after == alone
    assert after["drives"] == [far]
    assert said(context, ids["single"]) == ("held", False, "it meets no drive of the map")
    with context.database.read() as session:
        row = maps.submaps_of(session, ids["single"])[0]
        assert np.array_equal(row.T_enu_submap, own)


def test_a_guest_whose_place_lies_moves_nobody_and_is_told_why(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    arrive(context, made, ("one", "two"))
    without = published(context, tmp_path / "1")
    liar = made_drive("liar", STREET, WAYS["single"], 3, believed_shift_m=30.0, gnss=RTK)
    drive_id = add(context, liar, "D")
    assert published(context, tmp_path / "2") == without
    state, admitted, reason = said(context, drive_id)
    assert (state, admitted) == ("held", False)
    assert reason == "it meets no drive of the map" or "contradicted" in reason


def test_two_guests_that_meet_each_other_alone_vouch_for_nobody(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    twin = add(context, made_drive("twin", STREET, WAYS["one"], 8), "D")
    ids = arrive(context, made, ("single",))
    empty = published(context, tmp_path / "1")
    assert empty["drives"] == []
    assert {said(context, one) for one in (twin, ids["single"])} == {("held", False, "the map has no drive that it could meet")}
    add(context, made_drive("far", STREET, FAR, 5, gnss=RTK))
    published(context, tmp_path / "2")
    assert {said(context, one) for one in (twin, ids["single"])} == {("held", False, "it meets no drive of the map")}


def test_a_guest_that_was_admitted_lets_in_the_next_one(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    arrive(context, made, ("one",))
    chained = add(context, made_drive("chained", STREET, there(100.0, 200.0), 9), "D")
    published(context, tmp_path / "1")
    assert said(context, chained)[0] == "held"
    arrive(context, made, ("single",))
    published(context, tmp_path / "2")
    assert said(context, chained)[:2] == ("done", True)


def test_a_drive_without_gnss_enters_by_another_that_the_map_has_placed_in_every_order_of_arrival_alike(
    context: WorkerContext, new_service: NewService, tmp_path: Path
) -> None:
    ways = {"one": there(10.0, 140.0), "near": there(20.0, 250.0), "beyond": there(160.0, 270.0)}
    own = {name: made_drive(name, STREET, way, seed, name == "one", gnss=RTK) for seed, (name, way) in enumerate(ways.items(), 1)}
    service, ended = context, []
    for number, order in enumerate((("one", "near", "beyond"), ("beyond", "one", "near"))):
        ids, states = {}, []
        for name in order:
            ids[name] = add(service, own[name], "A" if name == "one" else None)
            map_now = published(service, tmp_path / f"{number}{name}")
            states.append({known: said(service, drive_id)[0] for known, drive_id in ids.items()})
        ended.append((map_now, {name: said(service, drive_id) for name, drive_id in ids.items()}))
        service = new_service(tmp_path / "other")
    assert ended[0] == ended[1]
    assert {name: state for name, (state, _, _) in ended[0][1].items()} == dict.fromkeys(ways, "done")
    assert ended[0][1]["beyond"][2].startswith("placed by")
    assert states[1]["beyond"] == "held", "without the drive between, nothing places it"


def test_a_release_makes_a_guest_a_member_and_its_end_a_guest_again(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    ids = arrive(context, made, ("one", "single"))
    with context.database.write() as session:
        assert gate.release(session, ids["single"], "Ada", "seen") is not None
    published(context, tmp_path / "1")
    assert said(context, ids["single"]) == ("done", False, "")
    with context.database.write() as session:
        assert gate.revoke(session, ids["single"]) is not None
    assert said(context, ids["single"])[0] == "stitching"
    published(context, tmp_path / "2")
    assert said(context, ids["single"])[:2] == ("done", True)


def test_a_drive_that_something_else_speaks_against_is_no_guest(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    arrive(context, made, ("one", "two"))
    broken = add(context, made["single"], "D", sound=False)
    worse = add(context, made_drive("worse", STREET, WAYS["single"], 7), "E", sound=False)
    published(context, tmp_path / "1")
    assert said(context, broken) == ("held", False, "")
    assert said(context, worse) == ("quarantined", False, "")


def test_a_drive_without_gnss_is_found_by_what_it_sees_and_loses_its_place_with_those_it_met(
    context: WorkerContext, new_service: NewService, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    ids = arrive(context, made, ("none",))
    published(context, tmp_path / "1")
    assert said(context, ids["none"])[:2] == ("held", False)
    ids |= arrive(context, made, ("one", "two"))
    at_last = published(context, tmp_path / "2")
    state, admitted, reason = said(context, ids["none"])
    assert (state, admitted) == ("done", True), reason
    assert off_m(context, made["none"], "none") < 0.3
    other = new_service(tmp_path / "other")
    arrive(other, made, ("two", "one"))
    without = published(other, tmp_path / "3")
    arrive(other, made, ("none",))
    assert published(other, tmp_path / "4") == at_last
    with other.database.write() as session:
        drives.request_removal(session, ids["none"])
    assert published(other, tmp_path / "5") == without
    with context.database.write() as session:
        for name in ("one", "two"):
            drives.request_removal(session, ids[name])
    published(context, tmp_path / "6")
    assert said(context, ids["none"])[:2] == ("held", False)
    with context.database.read() as session:
        assert [row.frame for row in maps.submaps_of(session, ids["none"])] == [None] * len(made["none"].submaps)
        assert maps.submaps(session, "city") == []


def test_a_drive_that_fits_two_streets_that_look_alike_is_held_with_these_words(context: WorkerContext, tmp_path: Path) -> None:
    street = made_street(6, alike=True)
    for name, block in (("here", 0), ("there", 2)):
        add(context, made_drive(name, street, there(block * BLOCK_M + 5.0, block * BLOCK_M + 65.0), 10 + block, gnss=RTK))
    without = published(context, tmp_path / "1")
    guest = add(context, made_drive("guest", street, there(5.0, 70.0), 13, located=False), None)
    assert published(context, tmp_path / "2") == without
    state, admitted, reason = said(context, guest)
    assert (state, admitted) == ("held", False)
    assert "streets look alike" in reason
