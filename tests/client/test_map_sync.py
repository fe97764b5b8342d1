"""A folder is kept equal to a map: what has changed travels, whatever interrupts it, and nothing is of another version."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit.published_tiles import PublishedMap, Tiles
from service_kit.running import ApiAlone, environment, until
from wayloom.client.api import Api
from wayloom.client.map_sync import SyncChoice, SyncOptions, SyncReport, sync_map
from wayloom.config.backoff import Backoff
from wayloom.errors import InputError, ServiceError

X, Y = 137_000, 90_000
"""A tile of zoom 18 near 8.1 degrees east, 49.0 north."""


def some_tiles(count: int, seed: int = 0, size: int = 3000) -> Tiles:
    """Tiles in a row at zoom 18, and a few of other layers and zooms."""
    found = {("semantic", 18, X + k, Y): content(f"{seed}/{k}", size) for k in range(count)}
    found |= {("points", 16, X // 4 + k, Y // 4): content(f"p{k}", 50) for k in range(3)}
    return found | {("markings", 16, X // 4, Y // 4): b"", ("semantic", 17, X // 2, Y // 2): content(f"{seed}/0", size)}


def content(name: str, size: int) -> bytes:
    return (hashlib.sha256(name.encode()).digest() * (size // 32 + 1))[:size]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    alone = ApiAlone(tmp_path_factory.mktemp("sync") / "data")
    yield alone
    alone.close()


@pytest.fixture
def city(server: ApiAlone, request: pytest.FixtureRequest) -> Iterator[PublishedMap]:
    """An empty map of the test's own."""
    made = PublishedMap(server.data, f"m{hashlib.sha256(request.node.name.encode()).hexdigest()[:8]}")
    yield made
    made.database.close()


@pytest.fixture
def api(server: ApiAlone) -> Iterator[Api]:
    with Api(server.url, retries=Backoff(0.05, 0.2, 3)) as found:
        yield found


def synced(api: Api, city: PublishedMap, folder: Path, options: SyncOptions | None = None, **part: Any) -> SyncReport:
    return sync_map(api, folder, SyncChoice(city.map_id, **part), options)


def tiles_in(folder: Path) -> dict[str, bytes]:
    """The files of a folder but for its own."""
    own = ("manifest.json", "SHA256SUMS", "tilejson.json")
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in own and ".wayloom-sync" not in path.parts
    }


def test_the_folder_equals_the_version_and_the_second_time_only_what_has_changed_moves(
    api: Api, city: PublishedMap, tmp_path: Path
) -> None:
    city.publish(first := some_tiles(40))
    report = synced(api, city, tmp_path)
    assert tiles_in(tmp_path) == city.files(1)
    distinct = set(first.values())
    assert (report.version, report.before, report.added, report.kept) == (1, None, 45, 0)
    assert (report.fetched_files, report.fetched_bytes) == (len(distinct), sum(map(len, distinct)))
    again = synced(api, city, tmp_path)
    assert (again.fetched_files, again.fetched_bytes, again.kept, again.before) == (0, 0, 45, 1)
    changed = dict(first) | {("semantic", 18, X + 5, Y): b"other", ("points", 16, X // 4, Y // 4 + 1): b"new"}
    del changed["semantic", 18, X + 6, Y], changed["markings", 16, X // 4, Y // 4]
    city.publish(changed)
    third = synced(api, city, tmp_path)
    assert (third.added, third.replaced, third.dropped, third.kept) == (1, 1, 2, 42)
    assert (third.fetched_files, third.fetched_bytes) == (2, len(b"other") + len(b"new"))
    assert tiles_in(tmp_path) == city.files(2)
    assert not (tmp_path / "markings").exists()  # its description went with its last tile


def test_what_is_written_beside_the_tiles_is_true_and_relative(api: Api, city: PublishedMap, tmp_path: Path) -> None:
    city.publish(some_tiles(5))
    synced(api, city, tmp_path)
    sums = subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=tmp_path, capture_output=True, text=True)
    assert (sums.returncode, sums.stderr) == (0, "")
    assert len((tmp_path / "SHA256SUMS").read_text().splitlines()) == 10
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert {name: manifest[name] for name in ("map", "version", "tiles", "bbox", "only_layers")} == {
        "map": city.map_id, "version": 1, "tiles": 10, "bbox": None, "only_layers": [],
    }  # fmt: skip
    assert manifest["bytes"] == sum(map(len, city.files(1).values()))
    said = json.loads((tmp_path / "semantic" / "tilejson.json").read_text())
    assert (said["tiles"], said["minzoom"], said["maxzoom"]) == (["{z}/{x}/{y}.png"], 17, 18)
    served = subprocess.Popen(
        [sys.executable, "-u", "-m", "http.server", "0", "--bind", "127.0.0.1", "--directory", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        assert served.stdout is not None
        port = served.stdout.readline().split("port ")[1].split()[0]
        base = httpx2.URL(f"http://127.0.0.1:{port}/semantic/tilejson.json")
        told = httpx2.get(base, trust_env=False).json()
        tile = base.join(told["tiles"][0].format(z=18, x=X, y=Y))
        assert httpx2.get(tile, trust_env=False).content == city.versions[0]["semantic", 18, X, Y]
    finally:
        served.kill()
        served.communicate()


def test_layers_and_a_box_choose_and_another_choice_fetches_only_what_is_lacking(
    api: Api, city: PublishedMap, tmp_path: Path
) -> None:
    city.publish(some_tiles(40))
    synced(api, city, tmp_path, layers=("points", "markings"))
    assert tiles_in(tmp_path) == city.files(1, "points", "markings")
    degree = 360.0 / 2**18
    west = -180.0 + degree * (X + 0.5)
    box = (west, 40.0, west + 2 * degree, 60.0)
    report = synced(api, city, tmp_path, bbox=box)
    columns = {18: (X, X + 1, X + 2), 17: (X // 2,), 16: (X // 4,)}
    parts = {path: path.split("/") for path in city.files(1)}
    inside = {path for path, (_, z, x, _) in parts.items() if int(x) in columns[int(z)]}
    assert tiles_in(tmp_path) == {path: data for path, data in city.files(1).items() if path in inside}
    assert report.kept == 2
    assert report.fetched_files == 3  # zoom 17 has the bytes of one of zoom 18
    with pytest.raises(ServiceError, match="no layer 'meadows'"):
        synced(api, city, tmp_path, layers=("meadows",))


def test_files_that_were_changed_or_lost_are_mended_and_the_folders_own_account_may_be_lost_too(
    api: Api, city: PublishedMap, tmp_path: Path
) -> None:
    city.publish(some_tiles(10))
    synced(api, city, tmp_path)
    path = tmp_path / f"semantic/18/{X + 3}/{Y}.png"
    path.write_bytes(b"broken")
    (tmp_path / f"semantic/18/{X + 4}/{Y}.png").unlink()
    assert synced(api, city, tmp_path).fetched_files == 2
    assert tiles_in(tmp_path) == city.files(1)
    stat = path.stat()
    path.write_bytes(bytes(reversed(path.read_bytes())))
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # a disk's fault: neither size nor time tell of it
    assert synced(api, city, tmp_path).fetched_files == 0
    assert synced(api, city, tmp_path, SyncOptions(check=True)).fetched_files == 1
    shutil.rmtree(tmp_path / ".wayloom-sync")
    report = synced(api, city, tmp_path)
    assert (report.fetched_files, report.kept) == (0, 15)
    assert tiles_in(tmp_path) == city.files(1)


def test_strays_are_named_and_deleted_only_when_asked_for(api: Api, city: PublishedMap, tmp_path: Path) -> None:
    city.publish(some_tiles(2))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    assert synced(api, city, tmp_path).strays == ("notes/mine.txt",)
    assert (tmp_path / "notes" / "mine.txt").exists()
    assert synced(api, city, tmp_path, SyncOptions(delete=True)).strays == ("notes/mine.txt",)
    assert not (tmp_path / "notes").exists()
    assert tiles_in(tmp_path) == city.files(1)


def test_a_version_that_is_published_meanwhile_is_not_mixed_in(api: Api, city: PublishedMap, tmp_path: Path) -> None:
    city.publish(some_tiles(30, seed=1))
    published = []

    def publish_once(_share: float, _what: str, /) -> None:
        if not published:
            published.append(city.publish(some_tiles(30, seed=2)))

    report = sync_map(api, tmp_path, SyncChoice(city.map_id), progress=publish_once)
    assert (published, report.version) == ([2], 1)
    assert tiles_in(tmp_path) == city.files(1)
    assert synced(api, city, tmp_path).version == 2
    assert tiles_in(tmp_path) == city.files(2)


def test_a_version_that_goes_meanwhile_is_left_for_the_newest(api: Api, city: PublishedMap, tmp_path: Path) -> None:
    city.publish(some_tiles(30, seed=1))

    def publish_many(_share: float, _what: str, /) -> None:
        while len(city.versions) < 7:  # five are kept
            city.publish(some_tiles(30, seed=len(city.versions) + 1))

    assert sync_map(api, tmp_path, SyncChoice(city.map_id), progress=publish_many).version == 7
    assert tiles_in(tmp_path) == city.files(7)


def test_a_folder_whose_version_is_not_kept_any_more_fetches_only_what_it_lacks(
    api: Api, city: PublishedMap, tmp_path: Path
) -> None:
    city.publish(some_tiles(10))
    synced(api, city, tmp_path)
    for k in range(7):
        city.publish(some_tiles(10) | {("semantic", 18, X + 20, Y): f"{k}".encode()})
    report = synced(api, city, tmp_path)
    assert (report.version, report.before, report.fetched_files, report.kept) == (8, 1, 1, 15)
    assert tiles_in(tmp_path) == city.files(8)


def start_sync(server: ApiAlone, city: PublishedMap, folder: Path, *options: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "wayloom.cli.main", "sync", server.url, str(folder), "--map", city.map_id, *options]
    return subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_sync_that_is_killed_in_the_middle_goes_on(server: ApiAlone, city: PublishedMap, tmp_path: Path) -> None:
    """kill -9 of the real command, while it fetches and while it puts files in place."""
    city.publish(some_tiles(400, seed=1))
    incoming, folder = tmp_path / "city" / ".wayloom-sync" / "incoming", tmp_path / "city"
    killed = start_sync(server, city, folder, "--connections", "1")
    until(lambda: incoming.is_dir() and len([*incoming.iterdir()]) > 20)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert not (folder / "manifest.json").exists()
    come = len([file for file in incoming.iterdir() if not file.name.startswith(".")])
    done = start_sync(server, city, folder, "--json")
    out, err = done.communicate(timeout=60)
    assert done.returncode == 0
    said = json.loads(out)
    assert 0 < come < 404
    assert said["fetched_files"] == len(set(city.versions[0].values())) - come
    assert f"version 1 of map {city.map_id}: 405 new" in err
    assert tiles_in(folder) == city.files(1)


def test_a_sync_that_dies_while_it_puts_files_in_place_fetches_none_of_them_again(
    api: Api, city: PublishedMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    city.publish(some_tiles(30, seed=1))
    synced(api, city, tmp_path)
    city.publish(some_tiles(30, seed=2))
    real, left = os.replace, [20]

    def replace(source: object, target: object) -> None:
        if "incoming" in str(source) and "incoming" not in str(target):
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
        real(source, target)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        synced(api, city, tmp_path)
    monkeypatch.undo()
    mixed = tiles_in(tmp_path)
    assert mixed != city.files(1)
    assert mixed != city.files(2)
    report = synced(api, city, tmp_path)
    assert (report.before, report.version, report.fetched_files) == (1, 2, 0)
    assert tiles_in(tmp_path) == city.files(2)


def test_two_cannot_change_a_folder_at_once_and_one_of_another_map_is_refused(api: Api, city: PublishedMap, tmp_path: Path) -> None:
    city.publish(some_tiles(3))
    errors: list[BaseException] = []

    def meanwhile(_share: float, _what: str, /) -> None:
        def other() -> None:
            try:
                synced(api, city, tmp_path)
            except InputError as error:
                errors.append(error)

        if not errors:
            thread = threading.Thread(target=other)
            thread.start()
            thread.join()

    sync_map(api, tmp_path, SyncChoice(city.map_id), progress=meanwhile)
    assert "another process" in str(errors[0])
    with pytest.raises(InputError, match=f"holds map '{city.map_id}', not 'elsewhere'"):
        sync_map(api, tmp_path, SyncChoice("elsewhere"))


@pytest.mark.parametrize(
    ("arguments", "status", "word"),
    [
        (["http://127.0.0.1:9", "DIR"], 1, "does not answer"),
        (["URL", "FILE"], 2, "is a file"),
        (["URL", "DIR", "--map", "nowhere"], 1, "there is no map"),
        (["URL", "DIR", "--bbox", "1,2,3"], 2, "no box"),
    ],
)
def test_the_exit_status_says_whose_fault_it_is(
    server: ApiAlone, tmp_path: Path, arguments: list[str], status: int, word: str
) -> None:
    (tmp_path / "file").write_text("")
    named = {"URL": server.url, "DIR": str(tmp_path / "dir"), "FILE": str(tmp_path / "file")}
    command = [sys.executable, "-c", QUICK, "sync", *(named.get(one, one) for one in arguments)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60)
    assert done.returncode == status, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert word in done.stderr


QUICK = """
from wayloom.client import api
from wayloom.config.backoff import Backoff
api.Api.__init__.__defaults__ = (*api.Api.__init__.__defaults__[:-1], Backoff(0.01, 0.01, 2))
from wayloom.cli.main import main
main()
"""
"""The command with little patience."""


def test_a_server_that_names_a_place_outside_of_the_folder_or_sends_other_bytes_is_not_believed(
    api: Api, city: PublishedMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    city.publish(some_tiles(2))
    real = Api._answer

    def evil(self: Api, method: str, path: str, **request: Any) -> httpx2.Response:
        answer = real(self, method, path, **request)
        if path.endswith("/sync"):
            page = answer.json()
            page["add"][0]["name"] = "semantic/../../../up.png"
            return httpx2.Response(200, json=page)
        return answer

    monkeypatch.setattr(Api, "_answer", evil)
    with pytest.raises(ServiceError, match="names a tile"):
        synced(api, city, tmp_path / "a")

    def damaged(self: Api, method: str, path: str, **request: Any) -> httpx2.Response:
        answer = real(self, method, path, **request)
        return httpx2.Response(200, content=b"x" + answer.content) if "/tiles/" in path else answer

    monkeypatch.setattr(Api, "_answer", damaged)
    with pytest.raises(ServiceError, match="other bytes than the server lists"):
        synced(api, city, tmp_path / "b")
    assert tiles_in(tmp_path / "b") == {}
