"""A real `wayloom up` in processes of its own."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from service_kit.little_stages import RUNS
from service_kit.object_store import ObjectStoreServer
from wayloom.client.api import Api
from wayloom.config.backoff import Backoff

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
QUICK = {
    "WAYLOOM_STAGE_HOOKS": "service_kit.little_stages:hooks",
    "WAYLOOM_HEARTBEAT_S": "0.2",
    "WAYLOOM_LEASE_S": "4",
    "WAYLOOM_SWEEP_S": "0.2",
    "WAYLOOM_RESEND_S": "1",
    "WAYLOOM_RETRY_FIRST_S": "0.2",
    "WAYLOOM_MIN_FREE_BYTES": "0",
    "WAYLOOM_UPLOADS__RETENTION": "keep",
}


def environment(**more: str) -> dict[str, str]:
    """The variables of a service with small stages and little patience."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("WAYLOOM_")}
    paths = os.pathsep.join(str(ROOT / name) for name in ("core", "services", "workers", "tests"))
    return kept | QUICK | {"PYTHONPATH": paths} | more


class Up:
    """`wayloom up` and its children."""

    def __init__(self, data: Path, *arguments: str, **variables: str) -> None:
        self.data = data
        self._api: Api | None = None
        self.ready = data.parent / f"{data.name}.ready"
        command = [sys.executable, "-m", "wayloom.cli.main", "up", "--data", str(data), "--ready-file", str(self.ready), *arguments]
        if "--port" not in arguments:
            command += ["--port", "0"]
        self.process = subprocess.Popen(
            command, env=environment(**variables), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def wait(self) -> "Up":
        """Until it answers."""
        until(lambda: self.ready.is_file() or self.process.poll() is not None, 60)
        if self.process.poll() is not None:
            raise AssertionError(f"wayloom up ended: {self.process.stderr.read() if self.process.stderr else ''}")
        return self

    @property
    def url(self) -> str:
        """Where it listens."""
        return self.ready.read_text().strip()

    def api(self) -> Api:
        """A client that is closed with the service."""
        if self._api is None:
            self._api = Api(self.url, retries=Backoff(0.2, 2.0, 5))
        return self._api

    def children(self, what: str) -> list[int]:
        """Process ids of the children whose command line has these words."""
        return [pid for pid in descendants(self.process.pid) if what in command_line(pid)]

    def kill(self, what: str) -> int:
        """kill -9 of one child. Returns its process id."""
        pid = int(until(lambda: self.children(what))[0])
        self.kill_process(pid)
        return pid

    @staticmethod
    def kill_process(pid: int) -> None:
        """kill -9."""
        os.kill(pid, signal.SIGKILL)

    def runs(self) -> list[list[str]]:
        """What the stages wrote down: what, stage, attempt, process, drive."""
        path = self.data / RUNS
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    def stop(self) -> None:
        """As by Ctrl-C."""
        if self._api is not None:
            self._api.close()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            self.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()


@contextmanager
def service(data: Path, *arguments: str, **variables: str) -> Any:
    """A service for the length of a block."""
    up = Up(data, *arguments, **variables)
    try:
        yield up.wait()
    finally:
        up.stop()


def until(found: Callable[[], Any], seconds: float = 30.0) -> Any:
    """Ask until the answer is true, and return it."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if answer := found():
            return answer
        time.sleep(0.05)
    raise AssertionError(f"did not come true within {seconds} s")


def descendants(pid: int) -> list[int]:
    """Process ids of the children and theirs."""
    try:
        children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return children + [deeper for child in children for deeper in descendants(child)]


def command_line(pid: int) -> str:
    """The words that the process was started with."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


class ApiAlone:
    """The API as one process on a port of the system's choice, on the same port again after it was killed. No broker, no worker.

    objects : the object store into which it puts uploads; None: its data folder
    """

    def __init__(self, data: Path, store: ObjectStoreServer | None = None, **variables: str) -> None:
        self.data, self.objects, self.uploads_url = data, None, variables.get("WAYLOOM_UPLOADS__URL")
        if store is not None:
            self.uploads_url = self.uploads_url or store.new_url()
            self.objects = store.open(self.uploads_url)
            variables = store.variables | {"WAYLOOM_UPLOADS__URL": self.uploads_url} | variables
        self._variables = environment(WAYLOOM_DATA_DIR=str(data), **variables)
        self._listener = socket.create_server(("127.0.0.1", 0))
        subprocess.run([sys.executable, "-m", "wayloom.store"], env=self._variables, check=True)
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.start()

    def start(self) -> None:
        """Listen again on the same port."""
        fd = self._listener.fileno()
        command = [sys.executable, "-m", "wayloom_services", "--fd", str(fd)]
        self.process = subprocess.Popen(command, env=self._variables, pass_fds=(fd,))

    def kill(self) -> None:
        """kill -9."""
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        """Stop it and give the port back."""
        self.process.terminate()
        self.process.wait(20)
        self._listener.close()
