"""Stages one after the other, and beside them, where there is a second thread, those whose results no other one waits for."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from threading import Event
from typing import Final, Protocol, TypeVar

from wayloom.config.progress import NamedProgress, Progress
from wayloom.config.stages import STAGES, drive_stages

Result = TypeVar("Result")
Made = TypeVar("Made", covariant=True)
Whole = TypeVar("Whole")
TOLD_S: Final = 0.3
"""Who waits for a stage beside the others repeats its last report so often: the report may stop all."""


class _StoppedError(Exception):
    """The other stages have ended by an error, which is the one to tell."""


class Run(Protocol[Made]):
    """Runs a stage of a drive by so many threads."""

    def __call__(self, name: str, progress: NamedProgress, threads: int, /) -> Made: ...


def in_turn(
    run: Run[Result], progress: NamedProgress, threads: int, meanwhile: Callable[[Callable[[], dict[str, Result]]], Whole]
) -> Whole:
    """Run each stage of a drive, in the catalogue's order, and return what `meanwhile` does.

    With two threads or more, a stage that no other one reads begins in a thread of its own as soon as what it reads is there, and
    goes on while others run; while some of these are still to come it is given a thread less, since those that wait for one another
    come first. An error in the caller's thread, `progress` included, stops it at its next report; an error of its own is raised
    when the others are done.
    meanwhile : called in the caller's thread when all that others read is there, and what is beside them may still go on. Its
        argument waits for it, in any thread, and gives what `run` gave for each stage.
    """
    if threads < 2:
        results = {name: run(name, progress, threads) for name in drive_stages()}
        return meanwhile(lambda: results)
    read = {name for stage in STAGES for name in stage.results_read}
    done: dict[str, Result] = {}
    beside: dict[str, Future[Result]] = {}
    told = _ToldBeside(progress)

    def wait_for_all() -> dict[str, Result]:
        for name, future in beside.items():
            while not wait([future], TOLD_S).done:
                told.repeat(name)
        return {name: done[name] if name in done else beside[name].result() for name in drive_stages()}

    with ThreadPoolExecutor(len(STAGES) - len(read)) as pool:
        try:
            for name in (name for name in drive_stages() if name in read):
                done[name] = run(name, progress, threads)
                for stage in STAGES:
                    if stage.name not in read | beside.keys() and done.keys() >= set(stage.results_read):
                        given = threads if done.keys() >= read else threads - 1
                        beside[stage.name] = pool.submit(run, stage.name, told.named, given)
            whole = meanwhile(wait_for_all)
            wait_for_all()
            return whole
        finally:
            told.ending.set()


class _ToldBeside:
    """The progress of work beside the caller's thread, which ends by an error once `ending` is set; `repeat` tells it again."""

    def __init__(self, progress: NamedProgress) -> None:
        self._progress, self.ending = progress, Event()
        self._last: dict[str, tuple[float, str]] = {}

    def named(self, name: str, /) -> Progress:
        """As a `NamedProgress`."""
        tell = self._progress(name)

        def report(share: float, what: str, /) -> None:
            if self.ending.is_set():
                raise _StoppedError
            self._last[name] = share, what
            tell(share, what)

        return report

    def repeat(self, name: str) -> None:
        """What was last told of this work, by the thread that waits for it."""
        if name in self._last:
            self._progress(name)(*self._last[name])
