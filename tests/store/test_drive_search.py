"""The list of drives: filtered, searched, sorted, a page at a time, with counts."""

import pytest

from wayloom.store import drive_search, drives, fleet
from wayloom.store.database import Database
from wayloom.store.drive_search import Asked
from wayloom.store.history import MOST, note_event, of_drive, thin
from wayloom.store.manifest import Manifest, ManifestFile


def announce(database: Database, name: str, vehicle: str | None = None, state: str = "queued", grade: str | None = None) -> str:
    with database.write() as session:
        file = ManifestFile(path="log/a", size=3, sha256="0" * 64)
        row, _ = drives.register(session, Manifest(name=name, vehicle_id=vehicle, files=(file,)), "city")
        row.state, row.grade = state, grade
        return row.id


@pytest.fixture
def filled(database: Database) -> Database:
    for number, (name, vehicle, state, grade) in enumerate(
        [("Main Street", "van-1", "done", "A"), ("main 50%", "van-2", "done", "D"), ("Lane", None, "failed", None)]
    ):
        drive_id = announce(database, name, vehicle, state, grade)
        with database.write() as session:
            drives.get(session, drive_id).created_at = 100.0 + number
    return database


def names(database: Database, asked: Asked = Asked(), sort: str = "newest", limit: int = 10, offset: int = 0) -> list[str]:
    with database.read() as session:
        return [row.name for row in drive_search.page(session, asked, sort, limit, offset)]


def test_a_text_is_found_in_names_and_vehicles_in_any_case_and_means_itself(filled: Database) -> None:
    assert names(filled, Asked(search="MAIN")) == ["main 50%", "Main Street"]
    assert names(filled, Asked(search="50%")) == ["main 50%"]
    assert names(filled, Asked(search="%")) == ["main 50%"]
    assert names(filled, Asked(search="van-1")) == ["Main Street"]
    assert names(filled, Asked(search="main", state="done", vehicle="van-2")) == ["main 50%"]


def test_letters_beyond_ascii_are_found_in_any_case(database: Database) -> None:
    announce(database, "ÖSTLICHE ÉCOLE", "ЛАДА-1")
    for text in ("östliche é", "ÖSTLICHE", "лада"):
        assert names(database, Asked(search=text)) == ["ÖSTLICHE ÉCOLE"]


def test_the_start_of_an_id_finds_its_drive(filled: Database) -> None:
    with filled.read() as session:
        (row,) = drive_search.page(session, Asked(vehicle="van-1"), "newest", 1, 0)
        assert [one.id for one in drive_search.page(session, Asked(search=row.id[:10]), "newest", 9, 0)] == [row.id]


def test_orders_and_pages(filled: Database) -> None:
    assert names(filled, sort="oldest") == ["Main Street", "main 50%", "Lane"]
    assert names(filled, sort="name") == ["Lane", "main 50%", "Main Street"]
    assert names(filled, sort="grade") == ["main 50%", "Main Street", "Lane"]
    assert names(filled, sort="oldest", limit=1, offset=1) == ["main 50%"]


def test_counts_by_state_and_of_what_was_asked_for(filled: Database) -> None:
    with filled.read() as session:
        assert drive_search.states(session, None) == {"done": 2, "failed": 1}
        assert drive_search.count(session, Asked(search="main")) == 2
        told = {one.id: (one.drives, one.bytes) for one in fleet.vehicles(session)}
    assert told == {"van-1": ({"done": 1}, 3), "van-2": ({"done": 1}, 3)}


def test_of_a_long_history_the_oldest_entries_go_and_those_of_a_removed_drive_go_with_it(database: Database) -> None:
    drive_id = announce(database, "long")
    with database.write() as session:
        for attempt in range(MOST + 5):
            note_event(session, drive_id, "odometry", "begun", attempt=attempt)
        thin(session, drive_id)
    with database.read() as session:
        assert [row.attempt for row in of_drive(session, drive_id, 10_000)] == list(range(MOST + 4, 4, -1))
    with database.write() as session:
        drives.delete_rows(session, drive_id)
    with database.read() as session:
        assert of_drive(session, drive_id, 10) == []
