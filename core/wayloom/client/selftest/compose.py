"""The grip on the processes of a deployment by docker compose, such as that of the repository's docker-compose.yml."""

import contextlib
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from wayloom.client.selftest.hands import NotTriedError
from wayloom.errors import ConfigError, ServiceError

API, BROKER, DATABASE, SWEEPER, WORKER = "api", "broker", "database", "sweeper", "worker"
"""Names of the file's services; those of workers begin with the last."""
LIMIT_S: Final = 120
BESIDE_S: Final = 600
"""A process beside the others ends by itself after so long, for it outlives the command that began it."""
Run = Callable[[Sequence[str]], str]


class ComposeHands:
    """A deployment that runs, by its file; its address is given."""

    def __init__(self, file: Path, url: str, key: str | None, lease_s: float, run: Run | None = None) -> None:
        """run : runs a command and returns what it prints

        Raises ConfigError where there is no docker, ServiceError where it does not know the deployment.
        """
        if run is None and shutil.which("docker") is None:
            raise ConfigError("there is no docker on this machine", record="--compose", remedy="run it where the deployment runs")
        self.url, self.key, self.lease_s = url, key, lease_s
        self._base = ["docker", "compose", "-f", str(file)]
        self._run = run or _ran
        names = self._compose("ps", "--services", "--status", "running").split()
        self._workers = [name for name in names if name.startswith(WORKER)]
        if not self._workers:
            raise ServiceError(f"no workers of {file} run")

    def _compose(self, *arguments: str) -> str:
        return self._run([*self._base, *arguments])

    def _kill(self, *services: str) -> None:
        """A container that was killed by hand is not restarted by docker, so it is started by hand too."""
        self._compose("kill", "--signal", "SIGKILL", *services)
        self._compose("start", *services)

    def kill_api(self) -> None:
        """Its container."""
        self._kill(API)

    def kill_workers(self) -> None:
        """All of their containers."""
        self._kill(*self._workers)

    def hold_workers(self, seconds: float) -> None:
        """By the freezer of their control groups."""
        self._compose("pause", *self._workers)
        try:
            time.sleep(seconds)
        finally:
            self._compose("unpause", *self._workers)

    def wipe_broker(self) -> None:
        """FLUSHALL within its container."""
        self._compose("exec", "-T", BROKER, "valkey-cli", "FLUSHALL")

    def restart_database(self) -> None:
        """Its container."""
        self._kill(DATABASE)

    @contextlib.contextmanager
    def beside(self, *arguments: str) -> Iterator[None]:
        """Within the sweeper's container."""
        command = ["timeout", str(BESIDE_S), "python", *arguments]
        self._compose("exec", "-T", "-d", SWEEPER, *command)
        try:
            yield
        finally:
            self._kill(SWEEPER)

    @contextlib.contextmanager
    def full_disk(self) -> Iterator[None]:
        """The volume has no bound of its own."""
        raise NotTriedError("the volume is as large as the machine's disk, which others need")
        yield

    def jump_clock(self, seconds: float) -> None:
        """Containers have the machine's clock."""
        raise NotTriedError("containers have the machine's clock, which others need")


def _ran(command: Sequence[str]) -> str:
    """Raises ServiceError where it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ServiceError(f"{' '.join(command)}: {error}") from error
    if done.returncode:
        raise ServiceError(f"{' '.join(command)}: {done.stderr.strip()[-300:]}")
    return done.stdout
