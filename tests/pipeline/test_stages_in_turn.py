"""Stages of a drive in their order, and beside them those that no other stage waits for."""

from collections.abc import Callable
from threading import Event, current_thread, main_thread
from typing import TypeVar

import pytest

from wayloom.config.progress import NamedProgress, Progress, silent_for_each
from wayloom.config.stages import drive_stages
from wayloom.pipeline.stages_in_turn import in_turn

T = TypeVar("T")
WAIT_S = 30.0


def run_all(run: Callable[[str, NamedProgress, int], T], threads: int, progress: NamedProgress = silent_for_each) -> dict[str, T]:
    """What `run` gives for each stage."""
    return in_turn(run, progress, threads, lambda wait_for_all: wait_for_all())


def test_one_thread_runs_them_in_the_catalogue_s_order() -> None:
    ran: list[str] = []
    result = run_all(lambda name, progress, threads: ran.append(name) or len(ran), threads=1)
    assert ran == list(result) == list(drive_stages())


def test_looks_begin_with_what_they_read_and_go_on_while_others_run() -> None:
    looking, later = Event(), Event()

    def run(name: str, progress: NamedProgress, threads: int) -> bool:
        if name == "looks":
            assert current_thread() is not main_thread()
            looking.set()
            later.wait(WAIT_S)  # for a stage behind it: would it run in turn, this would take for ever
            return later.is_set()
        if name == "labelling":  # which the looks do not read
            return looking.wait(WAIT_S)
        if name == "loops":
            later.set()
        return True

    result = run_all(run, threads=2)
    assert list(result) == list(drive_stages())
    assert all(result.values())


def test_what_is_written_meanwhile_goes_on_beside_the_objects() -> None:
    writing = Event()

    def run(name: str, progress: NamedProgress, threads: int) -> str:
        if name == "objects":
            assert writing.wait(WAIT_S)
        return name.upper()

    def write(wait_for_all: Callable[[], dict[str, str]]) -> list[str]:
        assert current_thread() is main_thread()
        writing.set()
        return list(wait_for_all().values())

    assert in_turn(run, silent_for_each, 2, write) == [name.upper() for name in drive_stages()]


def test_a_stage_beside_those_that_others_wait_for_gets_a_thread_less_than_they_do() -> None:
    given = run_all(lambda name, progress, threads: threads, threads=3)
    assert {name for name, threads in given.items() if threads == 2} == {"looks"}
    assert set(given.values()) == {2, 3}


def test_an_error_while_writing_stops_the_objects_and_is_the_one_that_is_told() -> None:
    begun = Event()

    def run(name: str, progress: NamedProgress, threads: int) -> None:
        while name == "objects":
            progress(name)(0.5, "looking")
            begun.set()

    def write(wait_for_all: Callable[[], dict[str, None]]) -> None:
        assert begun.wait(WAIT_S)
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        in_turn(run, silent_for_each, 2, write)


def test_an_error_of_the_others_stops_them_and_is_the_one_that_is_told() -> None:
    begun = Event()
    reports: list[float] = []

    def run(name: str, progress: NamedProgress, threads: int) -> None:
        if name == "looks":
            while True:
                progress(name)(0.5, "looking")
                reports.append(0.5)
                begun.set()
        if name == "georeference":
            assert begun.wait(WAIT_S)
            raise ValueError("no place")

    with pytest.raises(ValueError, match="no place"):
        run_all(run, threads=2)
    assert reports


def test_their_own_error_is_raised_when_the_others_are_done() -> None:
    ran: list[str] = []

    def run(name: str, progress: NamedProgress, threads: int) -> None:
        if name == "looks":
            raise ValueError("no look")
        ran.append(name)

    with pytest.raises(ValueError, match="no look"):
        run_all(run, threads=2)
    assert set(ran) >= {"ground", "submaps"}


def test_who_waits_for_the_last_of_them_can_be_stopped() -> None:
    class Enough(Exception):  # noqa: N818 - as an interrupt
        pass

    def progress(name: str, /) -> Progress:
        def report(share: float, what: str, /) -> None:
            if current_thread() is main_thread():
                raise Enough

        return report

    ended = Event()

    def run(name: str, progress: NamedProgress, threads: int) -> None:
        if name == "looks":
            try:
                while True:
                    progress(name)(0.5, "looking")
            finally:
                ended.set()

    with pytest.raises(Enough):
        run_all(run, 2, progress)
    assert ended.is_set()
