"""`wayloom drives` against a real service with small stages."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from service_kit.packed_drives import packed_drive
from service_kit.running import Up, service, until
from wayloom.cli.main import app
from wayloom.client.drives import all_drives
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.errors import ConfigError, NotFoundError


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    with service(tmp_path_factory.mktemp("drives") / "data", "--workers", "2") as running:
        yield running


@pytest.fixture(scope="module")
def held(up: Up, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The id of a drive of grade D, named `held`."""
    sent = upload(up.api(), packed_drive(tmp_path_factory.mktemp("held"), "held", {"grade": "D"}))
    return str(wait_for_drive(up.api(), sent["id"])["id"])


def drives(up: Up, *arguments: object) -> Result:
    """`wayloom drives ARGUMENTS --to` the service, in this process; its error is that of the result."""
    return CliRunner().invoke(app, ["drives", *(str(one) for one in arguments), "--to", up.url], standalone_mode=False)


def test_the_list_has_a_line_a_drive_and_all_of_it_as_json(up: Up, held: str) -> None:
    told = drives(up, "list", "--state", "held")
    assert told.exit_code == 0, told.exception
    assert told.stdout.split()[:4] == [held[:12], "held", "D", "held"]
    assert json.loads(drives(up, "list", "--json").stdout)["drives"][0]["id"] == held
    assert drives(up, "list", "--state", "uploading").stdout == "no drive is uploading\n"


def test_a_drive_is_found_by_its_name_or_the_beginning_of_its_id(up: Up, held: str) -> None:
    by_name, by_id = drives(up, "show", "held"), drives(up, "show", held[:8])
    assert by_name.stdout == by_id.stdout
    assert "grade D, hold" in by_name.stdout
    assert "sigma of the position 2.00 m in the median" in by_name.stdout
    assert json.loads(drives(up, "show", "held", "--json").stdout)["id"] == held


def test_an_unknown_drive_is_one_line_that_says_where_to_look(up: Up) -> None:
    told = drives(up, "show", "nobody").exception
    assert isinstance(told, NotFoundError)
    assert str(told) == f"no drive is called 'nobody'; `wayloom drives list --to {up.url}` shows them"


def test_a_drive_that_failed_is_watched_to_its_end_and_tried_again(up: Up, tmp_path: Path) -> None:
    sent = str(upload(up.api(), packed_drive(tmp_path, "damaged", {"odometry": {"bad": True}}))["id"])
    watched = drives(up, "watch", "damaged")
    assert watched.return_value == 1
    assert "record it again" in watched.stdout
    again = drives(up, "retry", "damaged")
    assert again.exit_code == 0, again.exception
    assert again.stdout.startswith(sent[:12])
    assert wait_for_drive(up.api(), sent)["state"] == "failed"


def test_the_report_is_one_page_with_grade_reasons_and_pictures(up: Up, held: str, tmp_path: Path) -> None:
    page, numbers = tmp_path / "report.html", tmp_path / "report.json"
    assert drives(up, "report", "held", "--out", page).exit_code == 0
    text = page.read_text()
    assert "Grade D, hold" in text
    assert "sigma of the position 2.00 m in the median" in text
    assert text.count("<svg") == 1
    assert "http-equiv" in text
    assert drives(up, "report", held[:8], "--out", numbers).exit_code == 0
    assert json.loads(numbers.read_text())["drive"]["id"] == held
    refused = drives(up, "report", "held", "--out", tmp_path / "report.pdf")
    assert isinstance(refused.exception, ConfigError)
    assert not (tmp_path / "report.pdf").exists()


def test_a_drive_is_deleted_only_where_somebody_says_so(up: Up, tmp_path: Path) -> None:
    sent = str(upload(up.api(), packed_drive(tmp_path, "unwanted"))["id"])
    wait_for_drive(up.api(), sent)
    asked = drives(up, "delete", "unwanted").exception
    assert isinstance(asked, ConfigError)
    assert str(asked) == "nobody is there to be asked; say --yes"
    assert sent in {one["id"] for one in all_drives(up.api())}
    assert drives(up, "delete", "unwanted", "--yes").exit_code == 0
    until(lambda: sent not in {one["id"] for one in all_drives(up.api())})
