"""Spool of a vehicle: what is complete is sent, and nothing is deleted before the server has accepted it."""

import errno
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit.running import ApiAlone, until
from wayloom.client import spooling
from wayloom.client.api import AnswerError, Api
from wayloom.client.manifests import PackedDrive, hash_file
from wayloom.client.rates import RateLimit, bytes_a_second
from wayloom.client.spool import Record, Spool, Then, signature_of
from wayloom.client.spooling import Watching, watch
from wayloom.config.backoff import Backoff
from wayloom.errors import ConfigError, InputError, LogError
from wayloom.store import jobs
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile

QUICK = Backoff(0.05, 0.1)


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


def packed(log: Path) -> PackedDrive:
    return spooling.pack(log)


@pytest.fixture
def another_file_system(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first rename is one to another file system."""
    rename, failed = os.rename, list[bool]()

    def fails_once(source: Path, target: Path) -> None:
        if not failed:
            failed.append(True)
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        rename(source, target)

    monkeypatch.setattr(os, "rename", fails_once)


@pytest.mark.usefixtures("another_file_system")
def test_a_log_is_moved_to_another_file_system(spool: Path, tmp_path: Path) -> None:
    log, looks = log_in(spool, "far"), Spool(spool, 60)
    with looks.locked():
        assert looks.finish(log, signature_of(log), packed(log), Then.MOVE, tmp_path / "sent")
    assert sorted(path.name for path in (tmp_path / "sent" / "far").iterdir()) == ["0.png", "1.png", "2.png", "notes.txt"]
    assert [path.name for path in spool.iterdir()] == [".wayloom"]
    assert [path.name for path in (spool / ".wayloom").iterdir()] == ["lock"]


@pytest.mark.usefixtures("another_file_system")
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_log_that_grows_while_it_is_copied_stays_whole(
    spool: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    log, looks, copytree = log_in(spool, "grows"), Spool(spool, 60), shutil.copytree

    def copying(source: Path, target: Path, symlinks: bool) -> None:
        if when == "before":
            (log / "late.png").write_bytes(b"late")
        copytree(source, target, symlinks=symlinks)
        (log / "late.png").write_bytes(b"late")

    monkeypatch.setattr(shutil, "copytree", copying)
    with looks.locked():
        assert not looks.finish(log, signature_of(log), packed(log), Then.MOVE, tmp_path / "sent")
        assert [path.name for path, _ in looks.complete()] == ["grows"]
    assert len(list(log.iterdir())) == 5
    assert list((tmp_path / "sent").iterdir()) == []


@pytest.mark.usefixtures("another_file_system")
def test_a_copy_that_a_reboot_cut_short_leaves_a_log_that_is_sent_again(
    spool: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, looks = log_in(spool, "cut"), Spool(spool, 60)

    def dies(source: Path, target: Path, symlinks: bool) -> None:
        target.mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "copytree", dies)
    with pytest.raises(KeyboardInterrupt), looks.locked():
        looks.finish(log, signature_of(log), packed(log), Then.MOVE, tmp_path / "sent")
    with Spool(spool, 60).locked():
        assert [path.name for path, _ in Spool(spool, 60).complete()] == ["cut"]


def test_deleting_that_a_reboot_cut_short_goes_on(spool: Path) -> None:
    log, looks = log_in(spool, "half"), Spool(spool, 60)
    before = signature_of(log)
    with looks.locked():
        looks.record(log, Record(before, "a" * 64, None, deleting=("0.png", "1.png", "2.png")))
    (log / "0.png").unlink()
    with looks.locked():
        assert [path.name for path in log.iterdir()] == ["notes.txt"]
        assert looks.complete() == []
        assert not looks.settling()


@pytest.mark.parametrize("status", [403, 409, 413, 422])
def test_a_log_that_the_server_refuses_holds_up_no_other(alone: ApiAlone, spool: Path, status: int) -> None:
    class Refusing(Api):
        """A server that does not take one of the logs, whatever comes of it."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            if method == "POST" and path.startswith("/v1/drives") and request["json"].get("name", "").startswith("a refused"):
                raise AnswerError(status, "refused", "not this one")
            return super().once(method, path, **request)

    for name in (f"a refused {status}", f"b taken {status}"):
        log_in(spool, name)
    said: list[str] = []
    with Refusing(alone.url) as api:
        accepted(alone, lambda: watch(api, Spool(spool, 60), watching(said=said), once=True))
    assert len(said) == 2
    assert said[0].endswith(f"refused and left where it is: the server answered {status}: not this one")
    assert "accepted" in said[1]


def test_a_log_for_which_the_quota_is_used_up_waits_and_holds_up_no_other(
    alone: ApiAlone, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spooling, "LONGEST_QUOTA_S", 3.0)

    class Full(Api):
        """A server that takes the large log only when the small one has gone."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            is_large = method == "POST" and path == "/v1/drives" and request["json"]["name"] == "a large one"
            if is_large and not any("b small one: accepted" in line for line in said):
                raise AnswerError(429, "quota-exceeded", "too many bytes", 86_400.0)
            return super().once(method, path, **request)

    for name in ("a large one", "b small one"):
        log_in(spool, name)
    said: list[str] = []
    with Full(alone.url) as api:
        accepted(alone, lambda: watch(api, Spool(spool, 60), watching(said=said), once=True))
    assert said[0] == "a large one: the server answered 429: too many bytes; it waits for 3 s, others do not"
    assert "b small one: accepted" in said[1]
    assert "a large one: accepted" in said[-1]


def test_a_key_that_is_not_known_is_no_refusal_of_a_log(spool: Path) -> None:
    class Closed(Api):
        """A server that does not know the key."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            raise AnswerError(401, "no-key", "give a key")

    log_in(spool, "waits for a key")
    said: list[str] = []
    with Closed("http://127.0.0.1:9") as api, pytest.raises(KeyboardInterrupt):
        watch(api, Spool(spool, 60), Watching(offline=QUICK, say=_StopAfter(said, 2)))
    assert all("trying again" in line for line in said)


def test_a_log_is_sent_while_the_server_has_yet_to_open_the_one_before(alone: ApiAlone, spool: Path) -> None:
    for name in ("first of two", "second of two"):
        log_in(spool, name)

    def both_wait(api: Api) -> bool:
        drives = [drive for drive in api.json("GET", "/v1/drives")["drives"] if drive["name"].endswith("of two")]
        return [drive["state"] for drive in drives] == ["queued", "queued"]

    with Api(alone.url) as api:
        task = threading.Thread(target=watch, args=(api, Spool(spool, 60), watching()), kwargs={"once": True}, daemon=True)
        task.start()
        until(lambda: both_wait(api))
        accepted(alone, task.join)


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
