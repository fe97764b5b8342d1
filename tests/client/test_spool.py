"""Spool of a vehicle: what is complete is sent, and nothing is deleted before the server has accepted it."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service_kit.running import ApiAlone, until
from wayloom.client import spooling
from wayloom.client.api import Api
from wayloom.client.manifests import PackedDrive, hash_file
from wayloom.client.rates import RateLimit, bytes_a_second
from wayloom.client.spool import Spool, Then
from wayloom.client.spooling import Watching, watch
from wayloom.config.backoff import Backoff
from wayloom.errors import ConfigError, InputError, LogError
from wayloom.store import jobs
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile

QUICK = Backoff(0.05, 0.1)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    server = ApiAlone(tmp_path_factory.mktemp("server") / "data")
    yield server
    server.close()


@pytest.fixture
def spool(tmp_path: Path) -> Path:
    (tmp_path / "spool").mkdir()
    return tmp_path / "spool"


@pytest.fixture(autouse=True)
def every_folder_is_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs of a recording are large; what a spool does with one does not depend on what is in it."""

    def pack(log: Path, vehicle_id: str | None = None, progress: object = None) -> PackedDrive:
        if (log / "bad").exists():
            raise LogError("is no log", file=log, remedy="give one")
        sources = {f"log/{path.name}": path for path in sorted(log.glob("*.png"))}
        files = [ManifestFile(path=name, size=hash_file(path)[0], sha256=hash_file(path)[1]) for name, path in sources.items()]
        return PackedDrive(Manifest(name=log.name, files=tuple(files)), sources)

    monkeypatch.setattr(spooling, "pack", pack)


def log_in(spool: Path, name: str, complete: bool = True) -> Path:
    (spool / name).mkdir()
    for i in range(3):
        (spool / name / f"{i}.png").write_bytes(f"{name} {i}".encode())
    (spool / name / "notes.txt").write_text("not part of the log")
    if complete:
        (spool / f"{name}.complete").touch()
    return spool / name


def accept_all(server: ApiAlone, over: threading.Event, state: str = "done") -> None:
    """What a worker would say: the stage that opens a log is done, or failed."""
    database = Database(f"sqlite:///{server.data / 'wayloom.db'}")
    while not over.wait(0.1):
        with database.write() as session:
            for job in session.query(jobs.Job).filter_by(stage="ingest", state="queued"):
                job.state = state
    database.close()


def accepted(server: ApiAlone, work: Callable[[], None]) -> None:
    over = threading.Event()
    worker = threading.Thread(target=accept_all, args=(server, over))
    worker.start()
    try:
        work()
    finally:
        over.set()
        worker.join()


def watching(then: Then = Then.KEEP, target: Path | None = None, said: list[str] | None = None) -> Watching:
    return Watching(then, target, poll_s=0.05, offline=QUICK, say=[].append if said is None else said.append)


def test_a_log_is_deleted_when_it_was_accepted_but_not_what_was_not_sent(alone: ApiAlone, spool: Path) -> None:
    log = log_in(spool, "deleted")
    with Api(alone.url) as api:
        accepted(alone, lambda: watch(api, Spool(spool, 60), watching(Then.DELETE), once=True))
    assert [path.name for path in log.iterdir()] == ["notes.txt"]
    assert not (spool / "deleted.complete").exists()


def test_a_log_is_not_touched_before_the_server_has_accepted_it(alone: ApiAlone, spool: Path) -> None:
    log = log_in(spool, "waits")
    with Api(alone.url) as api:
        task = threading.Thread(target=watch, args=(api, Spool(spool, 60), watching(Then.DELETE)), kwargs={"once": True})
        task.start()
        until(
            lambda: any(
                drive["name"] == "waits" and drive["state"] == "queued" for drive in api.json("GET", "/v1/drives")["drives"]
            )
        )
        time.sleep(0.3)
        assert len(list(log.glob("*.png"))) == 3
        accepted(alone, task.join)
    assert not list(log.glob("*.png"))


def test_a_log_is_moved_and_one_of_the_same_name_is_not_overwritten(alone: ApiAlone, spool: Path, tmp_path: Path) -> None:
    (tmp_path / "sent" / "moved").mkdir(parents=True)
    log_in(spool, "moved")
    with Api(alone.url) as api:
        accepted(alone, lambda: watch(api, Spool(spool, 60), watching(Then.MOVE, tmp_path / "sent"), once=True))
    assert not (spool / "moved").exists()
    assert len(list((tmp_path / "sent" / "moved-2").iterdir())) == 4


def test_a_log_that_was_kept_is_sent_once_also_by_the_next_process(alone: ApiAlone, spool: Path) -> None:
    log_in(spool, "kept")
    said: list[str] = []
    with Api(alone.url) as api:
        accepted(alone, lambda: watch(api, Spool(spool, 60), watching(said=said), once=True))
        watch(api, Spool(spool, 60), watching(said=said), once=True)
    assert len(said) == 1


def test_a_server_that_is_away_is_waited_for(spool: Path, tmp_path: Path) -> None:
    server, said = ApiAlone(tmp_path / "data"), list[str]()
    try:
        with Api(server.url, retries=Backoff(0.01, 0.01, 1)) as api:
            until(lambda: api.json("GET", "/healthz"))
            server.kill()
            server._listener.close()
            log_in(spool, "offline")
            stopped = _StopAfter(said, 3)
            with pytest.raises(KeyboardInterrupt):
                watch(api, Spool(spool, 60), Watching(offline=QUICK, say=stopped))
        assert all("trying again" in line for line in said)
        assert len(list((spool / "offline").iterdir())) == 4
    finally:
        server.close()


class _StopAfter:
    """Notes lines and stops the watch, as Ctrl-C does, after so many."""

    def __init__(self, said: list[str], count: int) -> None:
        self._said, self._count = said, count

    def __call__(self, line: str) -> None:
        self._said.append(line)
        if len(self._said) == self._count:
            raise KeyboardInterrupt


def test_what_is_no_log_is_left_and_said_once(alone: ApiAlone, spool: Path) -> None:
    (log_in(spool, "broken") / "bad").touch()
    said: list[str] = []
    with Api(alone.url) as api:
        for _ in range(2):
            watch(api, Spool(spool, 60), watching(Then.DELETE, said=said), once=True)
    assert len(said) == 1
    assert "is no log" in said[0]
    assert len(list((spool / "broken").iterdir())) == 5


def test_without_a_marker_a_log_is_complete_when_nothing_has_changed_for_a_while(spool: Path) -> None:
    now = 0.0
    log = log_in(spool, "growing", complete=False)
    looks = Spool(spool, 10.0, clock=lambda: now)
    assert looks.complete() == []
    now = 9.0
    assert looks.complete() == []
    (log / "3.png").write_bytes(b"more")
    now = 15.0
    assert looks.complete() == []
    now = 26.0
    assert [path.name for path, _ in looks.complete()] == ["growing"]


def test_only_one_process_watches_a_spool(spool: Path) -> None:
    with Spool(spool, 1).locked(), pytest.raises(InputError, match="another process"), Spool(spool, 1).locked():
        pass


def test_a_limit_of_speed_is_kept_over_all_threads() -> None:
    limit, started = RateLimit(1e6), time.monotonic()
    block = memoryview(bytes(50_000))
    senders = [threading.Thread(target=lambda: list(limit.over([block] * 3))) for _ in range(2)]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join()
    assert time.monotonic() - started >= 0.25  # of 300 kB the last 50 begin then at the earliest


@pytest.mark.parametrize(("text", "rate"), [("2MB/s", 2e6), ("500kB", 5e5), ("1.5 MiB/s", 1.5 * 2**20), ("100B/s", 100.0)])
def test_a_rate_is_read_as_people_write_it(text: str, rate: float) -> None:
    assert bytes_a_second(text) == rate


@pytest.mark.parametrize("text", ["fast", "2", "0MB/s", "-1MB/s", "2mb/s"])
def test_what_is_no_rate_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        bytes_a_second(text)
