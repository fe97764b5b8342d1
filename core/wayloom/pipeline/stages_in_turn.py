"""Stages one after the other, and beside them, where there is a second thread, those whose results no stage waits for."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from threading import Event
from typing import Final, TypeVar

from wayloom.config.progress import NamedProgress, Progress
from wayloom.config.stages import STAGES, drive_stages

Result = TypeVar("Result")
TOLD_S: Final = 0.3
"""While it waits, the caller's thread repeats the last report of a stage beside it so often: the report may stop all."""


class _StoppedError(Exception):
    """The other stages have ended by an error, which is the one to tell."""


def in_turn(run: Callable[[str, NamedProgress], Result], progress: NamedProgress, threads: int) -> dict[str, Result]:
    """What `run` gives for each stage of a drive, in the catalogue's order.

    With two threads or more, a stage that no other one reads begins in a thread of its own as soon as what it reads is there, and
    goes on while others run. An error in the caller's thread, `progress` included, stops it at its next report; an error of its own
    is raised when the others are done.
    """
    if threads < 2:
        return {name: run(name, progress) for name in drive_stages()}
    read = {name for stage in STAGES for name in stage.results_read} | {drive_stages()[-1]}
    done: dict[str, Result] = {}
    beside: dict[str, Future[Result]] = {}
    told = _ToldBeside(progress)
    with ThreadPoolExecutor(1) as pool:
        try:
            for name in (name for name in drive_stages() if name in read):
                done[name] = run(name, progress)
                for stage in STAGES:
                    if stage.name not in read | beside.keys() and done.keys() >= set(stage.results_read):
                        beside[stage.name] = pool.submit(run, stage.name, told.named)
            for name, future in beside.items():
                while not wait([future], TOLD_S).done:
                    told.repeat(name)
                done[name] = future.result()
        finally:
            told.ending.set()
    return {name: done[name] for name in drive_stages()}


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
        """What was last told of this work, by the caller's thread."""
        if name in self._last:
            self._progress(name)(*self._last[name])
