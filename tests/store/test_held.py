"""Values of the database that a process holds for some seconds."""

from collections.abc import Iterator
from itertools import count
from threading import Barrier, Event, Thread

import pytest

from wayloom.store.database import Database, Session
from wayloom.store.held import Held


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def session(database: Database) -> Iterator[Session]:
    with database.read() as opened:
        yield opened


def test_a_value_is_read_once_in_its_time_and_anew_after_it(session: Session) -> None:
    clock, reads = Clock(), count()
    held = Held(lambda _: next(reads), 5.0, clock)
    assert held(session) == 0
    clock.now = 4.9
    assert held(session) == 0
    clock.now = 5.0
    assert held(session) == 1


def test_a_read_that_fails_is_told_and_the_next_one_reads_again(session: Session) -> None:
    answers = iter([ValueError("away"), "there"])

    def read(_: Session) -> str:
        answer = next(answers)
        if isinstance(answer, ValueError):
            raise answer
        return answer

    held = Held(read, 5.0, Clock())
    with pytest.raises(ValueError, match="away"):
        held(session)
    assert held(session) == "there"


def test_who_asks_while_another_thread_reads_gets_what_was_held_and_does_not_wait(session: Session) -> None:
    clock, reading, go_on = Clock(), Event(), Event()
    values = count()

    def read(_: Session) -> int:
        value = next(values)
        if value == 1:
            reading.set()
            assert go_on.wait(30.0)
        return value

    held = Held(read, 5.0, clock)
    assert held(session) == 0
    clock.now = 6.0
    slow = Thread(target=held, args=(session,))
    slow.start()
    assert reading.wait(30.0)
    assert held(session) == 0
    go_on.set()
    slow.join()
    assert held(session) == 1


def test_the_first_who_ask_at_once_read_once(session: Session) -> None:
    reads: list[int] = []
    start = Barrier(4)
    held = Held(lambda _: reads.append(1) or len(reads), 5.0, Clock())
    found: list[int] = []

    def ask() -> None:
        start.wait()
        found.append(held(session))

    threads = [Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (found, reads) == ([1] * 4, [1])
