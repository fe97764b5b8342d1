"""How many workers `wayloom up` starts where nobody says."""

import pytest

from wayloom.cli import up

GB = 1 << 30


@pytest.mark.parametrize(
    ("cores", "memory", "workers"),
    [(1, 16 * GB, 1), (2, 16 * GB, 2), (2, 4 * GB, 1), (2, 0, 2), (64, 256 * GB, 2)],
    ids=["one core", "two cores", "little memory", "memory unknown", "large machine"],
)
def test_two_workers_where_there_is_room_for_them(cores: int, memory: int, workers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(up, "default_threads", lambda: cores)
    monkeypatch.setattr(up, "machine_memory", lambda: memory)
    assert up.default_workers() == workers
