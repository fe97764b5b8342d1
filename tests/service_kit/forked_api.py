"""API processes that start in no time, forked from one that has made its application: for drills that kill hundreds of them."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from service_kit.running import environment

PARENT = """
import os, signal, sys, threading
import wayloom_services.__main__ as api
from wayloom.pipeline.settings import load_settings
app = api.create_app(load_settings().settings)
api.create_app = lambda _settings: app
assert threading.active_count() == 1, "nothing but one thread can be forked"
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
sys.argv = ["wayloom_services", "--fd", sys.argv[1]]
for _ in sys.stdin:
    pid = os.fork()
    if pid == 0:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os._exit(api.main())
    print(pid, flush=True)
os.kill(pid, signal.SIGKILL)  # whoever had it started is gone
"""


class ForkedApi:
    """As `service_kit.running.ApiAlone`."""

    def __init__(self, data: Path, **variables: str) -> None:
        self.data = data
        known = environment(WAYLOOM_DATA_DIR=str(data), **variables)
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=128)
        subprocess.run([sys.executable, "-m", "wayloom.store"], env=known, check=True)
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        fd = self._listener.fileno()
        self._parent = subprocess.Popen(
            [sys.executable, "-c", PARENT, str(fd)], env=known, pass_fds=(fd,), text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self.start()

    def start(self) -> None:
        """Listen again on the same port."""
        assert self._parent.stdin is not None
        assert self._parent.stdout is not None
        self._parent.stdin.write("\n")
        self._parent.stdin.flush()
        self.pid = int(self._parent.stdout.readline())

    def kill(self) -> None:
        """kill -9."""
        os.kill(self.pid, signal.SIGKILL)

    def close(self) -> None:
        """Stop it and give the port back."""
        self.kill()
        self._parent.terminate()
        self._parent.communicate(timeout=20)
        self._listener.close()
