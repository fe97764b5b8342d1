"""A `wayloom up` of our own in a temporary folder, and the grip on its processes."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Self

from wayloom.client.selftest.hands import NotTriedError
from wayloom.config.child_processes import ending_with_parent
from wayloom.config.service import ServiceSettings
from wayloom.errors import ServiceError

WORKERS: Final = 2
START_S: Final = 120.0
DISK_BYTES: Final = 400 << 20
PATIENCE: Final = {
    "WAYLOOM_HEARTBEAT_S": "0.2",
    "WAYLOOM_LEASE_S": "4",
    "WAYLOOM_SWEEP_S": "0.3",
    "WAYLOOM_RESEND_S": "1",
    "WAYLOOM_RETRY_FIRST_S": "0.2",
    "WAYLOOM_MIN_FREE_BYTES": "0",
    "WAYLOOM_MAX_LOSSES": "1000",
}
"""Less patience than a service has by default, so that drills take seconds; and no stage is quarantined for the drills' kills."""
CLOCK: Final = """\
import time

_true = time.time


def _shifted():
    try:
        with open({path!r}) as file:
            return _true() + float(file.read() or 0)
    except OSError:
        return _true()


time.time = _shifted
"""
"""What Python runs first in every process of the service: a clock that can be moved, as `time.time` tells it."""


class EmbeddedHands:
    """`wayloom up` with its workers, broker and database in a folder. Where this process may mount, the folder is a small disk."""

    key: str | None = None
    lease_s = float(PATIENCE["WAYLOOM_LEASE_S"])

    def __init__(self, workers: int = WORKERS, **variables: str) -> None:
        """variables : settings beside PATIENCE, as environment variables

        Raises ServiceError where the service does not start.
        """
        self.folder = Path(tempfile.mkdtemp(prefix="wayloom-drill-"))
        self.data, self._ready, self._shift = self.folder / "data", self.folder / "ready", self.folder / "clock-shift"
        self.data.mkdir()
        self.has_small_disk = _mounted(self.data)
        start = self.folder / "start"
        start.mkdir()
        (start / "sitecustomize.py").write_text(CLOCK.format(path=str(self._shift)))
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith("WAYLOOM_")}
        paths = os.pathsep.join(filter(None, (str(start), self.environment.get("PYTHONPATH"))))
        self.environment |= PATIENCE | {"PYTHONPATH": paths, "WAYLOOM_DATA_DIR": str(self.data)} | variables
        try:
            self._process, self.url = self._started(workers)
        except BaseException:
            self._remove()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._remove()

    def _started(self, workers: int) -> tuple[subprocess.Popen[bytes], str]:
        """The process and its address, once it answers."""
        command = [
            sys.executable, "-m", "wayloom.cli.main", "up", "--data", str(self.data), "--port", "0", "--workers", str(workers),
            "--ready-file", str(self._ready),
        ]  # fmt: skip
        with (self.folder / "up.log").open("wb") as log:
            process = subprocess.Popen(
                command, env=self.environment, stdout=log, stderr=log, preexec_fn=ending_with_parent(signal.SIGTERM)
            )
        ends = time.monotonic() + START_S
        while not self._ready.is_file():
            if process.poll() is not None or time.monotonic() > ends:
                process.kill()
                process.wait()
                raise ServiceError(f"`wayloom up` did not start: {(self.folder / 'up.log').read_text(errors='replace')[-500:]}")
            time.sleep(0.1)
        return process, self._ready.read_text().strip()

    def _remove(self) -> None:
        if self.has_small_disk:
            subprocess.run(["umount", "--lazy", str(self.data)], check=False)
        shutil.rmtree(self.folder, ignore_errors=True)

    def children(self, words: str) -> list[int]:
        """Process ids of the service's children whose command line has these words."""
        try:
            children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        except OSError:
            raise NotTriedError("this system does not tell a process's children") from None
        return [int(pid) for pid in children if words in _command_line(int(pid))]

    def kill_api(self) -> None:
        """kill -9."""
        _signalled(self.children("wayloom_services"), signal.SIGKILL)

    def kill_workers(self) -> None:
        """kill -9."""
        _signalled(self.children("wayloom_workers worker"), signal.SIGKILL)

    def hold_workers(self, seconds: float) -> None:
        """SIGSTOP, and SIGCONT."""
        held = self.children("wayloom_workers worker")
        _signalled(held, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            _signalled(held, signal.SIGCONT)

    def wipe_broker(self) -> None:
        """FLUSHALL on its socket."""
        try:
            with socket.socket(socket.AF_UNIX) as link:
                link.settimeout(10.0)
                link.connect(str(ServiceSettings(data_dir=self.data).broker_socket))
                link.sendall(b"FLUSHALL\r\n")
                answer = link.recv(64)
        except OSError as error:
            raise ServiceError(f"the broker does not answer: {error}") from error
        if not answer.startswith(b"+OK"):
            raise ServiceError(f"the broker answers FLUSHALL with {answer!r}")

    def restart_database(self) -> None:
        """SQLite is a file."""
        raise NotTriedError("the database is a file, there is no process to end")

    @contextlib.contextmanager
    def beside(self, *arguments: str) -> Iterator[None]:
        """A child of ours."""
        process = subprocess.Popen(
            [sys.executable, *arguments], env=self.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            preexec_fn=ending_with_parent(signal.SIGTERM),
        )  # fmt: skip
        try:
            yield
        finally:
            process.terminate()
            process.wait(30)

    @contextlib.contextmanager
    def full_disk(self) -> Iterator[None]:
        """A file that takes what is left of the mounted disk."""
        if not self.has_small_disk:
            raise NotTriedError("a small disk cannot be mounted here (it takes root on Linux)")
        balloon = self.data / "balloon"
        with balloon.open("wb", buffering=0) as file:
            for size in (1 << 20, 4096, 1):
                with contextlib.suppress(OSError):
                    while True:
                        file.write(b"\0" * size)
        try:
            yield
        finally:
            balloon.unlink()

    def jump_clock(self, seconds: float) -> None:
        """By the file that CLOCK reads."""
        draft = self._shift.with_suffix(".new")
        draft.write_text(str(seconds))
        draft.replace(self._shift)


def _mounted(folder: Path) -> bool:
    """Whether a small disk could be mounted there."""
    if sys.platform != "linux" or os.geteuid() != 0 or shutil.which("mount") is None:
        return False
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def _signalled(pids: list[int], number: signal.Signals) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def _command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""
