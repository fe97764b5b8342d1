"""Stages of a drive in their order, and beside them those that no other stage waits for."""

from threading import Event, current_thread, main_thread

import pytest

from wayloom.config.progress import NamedProgress, Progress, silent_for_each
from wayloom.config.stages import drive_stages
from wayloom.pipeline.stages_in_turn import in_turn

WAIT_S = 30.0


def test_one_thread_runs_them_in_the_catalogue_s_order() -> None:
    ran: list[str] = []
    result = in_turn(lambda name, progress: ran.append(name) or len(ran), silent_for_each, threads=1)
    assert ran == list(result) == list(drive_stages())


def test_looks_begin_with_what_they_read_and_go_on_while_others_run() -> None:
    looking, later = Event(), Event()

    def run(name: str, progress: NamedProgress) -> bool:
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

    result = in_turn(run, silent_for_each, threads=2)
    assert list(result) == list(drive_stages())
    assert all(result.values())


def test_an_error_of_the_others_stops_them_and_is_the_one_that_is_told() -> None:
    begun = Event()
    reports: list[float] = []

    def run(name: str, progress: NamedProgress) -> None:
        if name == "looks":
            while True:
                progress(name)(0.5, "looking")
                reports.append(0.5)
                begun.set()
        if name == "georeference":
            assert begun.wait(WAIT_S)
            raise ValueError("no place")

    with pytest.raises(ValueError, match="no place"):
        in_turn(run, silent_for_each, threads=2)
    assert reports


def test_their_own_error_is_raised_when_the_others_are_done() -> None:
    ran: list[str] = []

    def run(name: str, progress: NamedProgress) -> None:
        if name == "looks":
            raise ValueError("no look")
        ran.append(name)

    with pytest.raises(ValueError, match="no look"):
        in_turn(run, silent_for_each, threads=2)
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

    def run(name: str, progress: NamedProgress) -> None:
        if name == "looks":
            try:
                while True:
                    progress(name)(0.5, "looking")
            finally:
                ended.set()

    with pytest.raises(Enough):
        in_turn(run, progress, threads=2)
    assert ended.is_set()
