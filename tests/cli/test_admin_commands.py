"""`wayloom keys`, `users` and `audit`: against the database of a service that need not run."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from service_kit.running import environment
from wayloom.store.access import keys, users
from wayloom.store.access.passwords import is_right
from wayloom.store.database import Database
from wayloom.store.migrate import upgrade


@pytest.fixture
def data(tmp_path: Path) -> Path:
    database = Database(f"sqlite:///{tmp_path / 'wayloom.db'}")
    upgrade(database)
    database.close()
    return tmp_path


def wayloom(*arguments: str, text: str = "", status: int = 0) -> Any:
    """What a command prints, as JSON; what it says on stderr where it fails."""
    command = [sys.executable, "-m", "wayloom.cli.main", *arguments]
    done = subprocess.run(command, env=environment(NO_COLOR="1"), input=text, capture_output=True, text=True, timeout=120)
    assert done.returncode == status, done.stderr
    return json.loads(done.stdout) if status == 0 else done.stderr


def test_a_key_is_made_rotated_and_revoked_and_all_of_it_is_in_the_audit_log(data: Path) -> None:
    where = ("--data", str(data))
    made = wayloom("keys", "create", "van one", "--vehicle", "van-1", "--days", "30", *where)
    assert made["role"] == "vehicle"
    rotated = wayloom("keys", "rotate", made["prefix"], "--grace-hours", "1", *where)
    assert rotated["key"] != made["key"]
    database = Database(f"sqlite:///{data / 'wayloom.db'}")
    with database.read() as session:
        for text in (made["key"], rotated["key"]):
            found = keys.find(session, text)
            assert found is not None
            assert (found.prefix, found.vehicle_id) == (made["prefix"], "van-1")
    revoked = wayloom("keys", "revoke", made["prefix"], *where)
    assert revoked["revoked"] is not None
    with database.read() as session:
        assert keys.find(session, rotated["key"]) is None
    database.close()
    listed = wayloom("keys", "list", *where)
    assert [one["prefix"] for one in listed] == [made["prefix"]]
    assert "key" not in listed[0]
    noted = wayloom("audit", *where)
    assert [one["action"] for one in noted] == ["wayloom keys revoke", "wayloom keys rotate", "wayloom keys create"]
    assert {one["object"] for one in noted} == {f"key {made['prefix']}"}


def test_a_user_is_added_by_a_password_that_no_command_line_holds(data: Path) -> None:
    where = ("--data", str(data))
    wayloom("users", "add", "anna", "--role", "operator", "--password-stdin", *where, text="a good long password\n")
    wayloom("users", "password", "anna", "--password-stdin", *where, text="another long password\n")
    assert [(one["name"], one["role"]) for one in wayloom("users", "list", *where)] == [("anna", "operator")]
    database = Database(f"sqlite:///{data / 'wayloom.db'}")
    with database.read() as session:
        assert is_right("another long password", users.get(session, "anna").password)
    database.close()
    assert "12 to 256 letters" in wayloom("users", "add", "bert", "--password-stdin", *where, text="short\n", status=2)
    assert [wayloom("users", what, "anna", *where)["disabled"] for what in ("disable", "enable")] == [True, False]
    wayloom("users", "remove", "anna", *where)
    assert wayloom("users", "list", *where) == []
    assert [one["action"] for one in wayloom("audit", "--limit", "1", *where)] == ["wayloom users remove"]


def test_a_folder_without_a_service_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    assert "no service has kept anything there" in wayloom("keys", "list", "--data", str(tmp_path / "none"), status=2)
    assert os.listdir(tmp_path) == []
    assert "there is no key" in wayloom_of_new(tmp_path, "keys", "revoke", "0" * 12)


def wayloom_of_new(folder: Path, *arguments: str) -> str:
    """What a command that fails says of a fresh database."""
    database = Database(f"sqlite:///{folder / 'wayloom.db'}")
    upgrade(database)
    database.close()
    return str(wayloom(*arguments, "--data", str(folder), status=1))
