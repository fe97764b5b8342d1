"""The gate in a real service: what a bad grade keeps out of the map, what is said of it, and who lets it in."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service_kit.packed_drives import packed_drive
from service_kit.running import Up, service, until
from wayloom.cli.upload import summary
from wayloom.client.api import AnswerError
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    with service(tmp_path_factory.mktemp("gate") / "data", "--workers", "2") as running:
        yield running


def sent(up: Up, folder: Path, name: str, grade: str) -> str:
    return str(upload(up.api(), packed_drive(folder / name, name, {"grade": grade}))["id"])


def drives_of_map(up: Up) -> set[str]:
    return set(up.api().json("GET", "/v1/maps/city")["drives"])


def test_held_and_quarantined_drives_stay_out_until_somebody_releases_them(up: Up, tmp_path: Path) -> None:
    api = up.api()
    good, held, bad = (sent(up, tmp_path, name, grade) for name, grade in (("good", "B"), ("held", "D"), ("bad", "E")))
    ends = {drive_id: wait_for_drive(api, drive_id) for drive_id in (good, held, bad)}
    assert [ends[one]["state"] for one in (good, held, bad)] == ["done", "held", "quarantined"]
    assert ends[held]["quality"] == {
        "grade": "D", "gate": "hold", "reasons": ["sigma of the position 2.00 m in the median"], "release": None,
        "sound": False, "by_map": None,
    }  # fmt: skip
    assert summary(ends[good]).endswith("in the map, grade B")
    assert summary(ends[held]).endswith("held: grade D: sigma of the position 2.00 m in the median")
    assert ends[bad]["stages"][-1]["stage"] == "objects"
    assert ends[held]["progress"] == 1.0
    assert drives_of_map(up) == {good}
    assert {row["drive_id"] for row in api.json("GET", "/v1/maps/city/submaps")["submaps"]} == {good}
    released = api.json("POST", f"/v1/drives/{held}/release", json={"by": " Ada ", "why": "checked against the plan"})
    assert released["quality"]["release"]["by"] == "Ada"
    assert wait_for_drive(api, held)["state"] == "done"
    assert drives_of_map(up) == {good, held}
    api.json("DELETE", f"/v1/drives/{held}/release")
    until(lambda: drives_of_map(up) == {good})
    assert api.drive(held)["state"] == "held"


def test_a_release_while_the_map_is_stitched_reaches_the_version_after(up: Up, tmp_path: Path) -> None:
    api, waits = up.api(), up.data / "stitch-waits"
    late = sent(up, tmp_path, "late", "D")
    assert wait_for_drive(api, late)["state"] == "held"
    waits.touch()
    first = sent(up, tmp_path, "first", "A")
    until(lambda: any(one["stage"] == "stitch" and one["state"] == "running" for one in api.drive(first)["stages"]))
    assert api.json("POST", f"/v1/drives/{late}/release", json={"by": "Ada", "why": "seen"})["state"] == "stitching"
    waits.unlink()
    assert [wait_for_drive(api, drive_id)["state"] for drive_id in (first, late)] == ["done", "done"]
    assert {first, late} <= drives_of_map(up)


def test_removing_a_held_drive_leaves_the_map_as_it_is(up: Up, tmp_path: Path) -> None:
    api = up.api()
    wait_for_drive(api, sent(up, tmp_path, "one", "A"))
    held = sent(up, tmp_path, "other", "D")
    wait_for_drive(api, held)
    version = api.json("GET", "/v1/maps/city")["version"]
    api.once("DELETE", f"/v1/drives/{held}")
    until(lambda: held not in {drive["id"] for drive in api.json("GET", "/v1/drives")["drives"]})
    assert [drive["stages"] for drive in api.json("GET", "/v1/drives?state=stitching")["drives"]] == []
    assert api.json("GET", "/v1/maps/city")["version"] == version


def test_a_release_says_who_and_why(up: Up, tmp_path: Path) -> None:
    api = up.api()
    held = sent(up, tmp_path, "asked", "D")
    wait_for_drive(api, held)
    for body in ({}, {"by": "Ada"}, {"by": "Ada", "why": "  "}, {"by": "A\0", "why": "x"}, {"by": "a" * 129, "why": "x"}):
        with pytest.raises(AnswerError) as refused:
            api.once("POST", f"/v1/drives/{held}/release", json=body)
        assert refused.value.status == 422
    with pytest.raises(AnswerError) as refused:
        api.once("DELETE", f"/v1/drives/{held}/release")
    assert refused.value.status == 409
    assert held in {drive["id"] for drive in api.json("GET", "/v1/drives?state=held")["drives"]}


def test_the_quality_report_and_its_pictures_are_there_once_the_drive_is_judged(up: Up, tmp_path: Path) -> None:
    api = up.api()
    drive_id = sent(up, tmp_path, "reported", "A")
    wait_for_drive(api, drive_id)
    assert api.json("GET", f"/v1/drives/{drive_id}/quality")["pictures"] == ["track"]
    assert api.once("GET", f"/v1/drives/{drive_id}/quality/track.svg").headers["Content-Type"] == "image/svg+xml"
    with pytest.raises(AnswerError, match="it has track"):
        api.once("GET", f"/v1/drives/{drive_id}/quality/drift.svg")


def test_thresholds_are_settings(tmp_path: Path) -> None:
    with service(tmp_path / "data", WAYLOOM_GATE__MERGE_UP_TO="A", WAYLOOM_GATE__HOLD_UP_TO="B") as up:
        ends = [wait_for_drive(up.api(), sent(up, tmp_path, grade, grade))["state"] for grade in "ABC"]
    assert ends == ["done", "held", "quarantined"]
