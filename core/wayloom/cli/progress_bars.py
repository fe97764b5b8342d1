"""Progress bars on a terminal, lines elsewhere: the one `NamedProgress` of every command."""

import sys
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

from wayloom.cli.interrupts import check

if TYPE_CHECKING:
    from rich.progress import TaskID

    from wayloom.config.progress import Progress

LINE_EVERY = 0.25


class ProgressBars:
    """A bar on stderr for each piece of work. Where stderr is no terminal: a line in `lines` at the end of each.

    quarters : where there are no bars, a line at the beginning and after each quarter as well: for one long piece of work
    elsewhere : the work is a service's, and its words tell how long it took: a bar that began late would tell another time
    """

    def __init__(self, lines: TextIO | None = None, quarters: bool = False, elsewhere: bool = False) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(file=sys.stderr)
        self._lines = None if console.is_terminal else lines or sys.stderr
        self._quarters = quarters
        self._tasks: dict[str, TaskID] = {}
        self._shown: dict[str, float] = {}
        self._bars = Progress(
            TextColumn("{task.fields[name]}"), BarColumn(28), TextColumn("{task.percentage:3.0f} %"),
            TimeRemainingColumn(elapsed_when_finished=not elsewhere), TextColumn("{task.description}", style="dim"),
            console=console, disable=not console.is_terminal,
        )  # fmt: skip

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._bars.stop()

    def __call__(self, name: str, /) -> "Progress":
        """The progress of the work of this name: a bar of its own, from its first report on."""

        def show(share: float, what: str, /) -> None:
            if threading.current_thread() is threading.main_thread():
                check()
            if self._lines is None:
                self._draw(name, share, what)
            else:
                self._write(name, share, what, self._lines)

        return show

    def _draw(self, name: str, share: float, what: str) -> None:
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(what, total=1.0, name=name)
        self._bars.update(self._tasks[name], completed=share, description=what)

    def _write(self, name: str, share: float, what: str, lines: TextIO) -> None:
        shown = self._shown.get(name)
        if share >= 1.0 and shown != 1.0:
            lines.write(f"{name}: {what}\n")
            self._shown[name] = 1.0
        elif share < 1.0 and (shown is None or share >= shown + LINE_EVERY or shown == 1.0):
            if self._quarters:
                lines.write(f"{name} {100 * share:3.0f} %: {what}\n")
            self._shown[name] = share
        lines.flush()
