"""Child processes that are kept running, and none of which outlives the one that started them."""

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from wayloom.config.backoff import Backoff
from wayloom.config.child_processes import ending_with_parent

STOP_GRACE_S: Final = 8.0
RESTARTS: Final = Backoff(first_s=0.5, longest_s=15.0)
CALM_S: Final = 30.0
"""A child that ran this long before it died is restarted without a pause."""


@dataclass
class Child:
    """A process to keep running, and where its output goes."""

    name: str
    command: Sequence[str]
    environment: dict[str, str]
    log: Path
    pass_fds: tuple[int, ...] = ()
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    deaths: int = 0
    due: float = 0.0

    def start(self) -> None:
        """Start it. It dies with this process, and hears no Ctrl-C of its own."""
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                self.command, env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                pass_fds=self.pass_fds, preexec_fn=ending_with_parent(signal.SIGKILL),
            )  # fmt: skip
        self.started = time.monotonic()

    @property
    def running(self) -> bool:
        """Whether it lives."""
        return self.process is not None and self.process.poll() is None

    def last_words(self, lines: int = 5) -> str:
        """The end of its log."""
        try:
            return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


@dataclass
class Supervisor:
    """Starts children in order, restarts those that die, stops them in reverse order."""

    children: list[Child] = field(default_factory=list)

    def add(self, child: Child) -> None:
        """Start another child."""
        self.children.append(child)
        child.start()

    def look(self) -> list[str]:
        """Restart what has died, after a pause that doubles with each early death. Returns a line for each event."""
        events, now = [], time.monotonic()
        for child in self.children:
            if child.running:
                continue
            if child.due == 0.0:
                child.deaths = 1 if now - child.started > CALM_S else child.deaths + 1
                child.due = now + RESTARTS.pause_s(child.deaths)
                code = child.process.returncode if child.process else None
                events.append(f"{child.name} ended with status {code} and is started again; its log is {child.log}")
            elif now >= child.due:
                child.due = 0.0
                child.start()
        return events

    def stop(self) -> None:
        """Ask every child to end, last started first, and after a grace period make it."""
        for child in reversed(self.children):
            _signal(child, signal.SIGTERM)
        deadline = time.monotonic() + STOP_GRACE_S
        for child in reversed(self.children):
            if child.process is not None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.process.wait(max(0.05, deadline - time.monotonic()))
                _signal(child, signal.SIGKILL)
                child.process.wait()


def _signal(child: Child, number: signal.Signals) -> None:
    if child.process is not None and child.process.poll() is None:
        child.process.send_signal(number)


@contextlib.contextmanager
def compiling_kernels() -> Iterator[None]:
    """While this lasts, a process of its own compiles the kernels that the cache lacks, at low priority."""
    command = [sys.executable, "-m", "wayloom.pipeline.kernels_ahead"]
    silence = subprocess.DEVNULL
    child = subprocess.Popen(command, stdin=silence, stdout=silence, stderr=silence, preexec_fn=ending_with_parent(signal.SIGKILL))
    try:
        yield
    finally:
        child.kill()
        child.wait()
