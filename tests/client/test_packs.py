"""Packs: many small files as one resumable upload, each verified and stored as if it had come alone."""

import hashlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from logs.made_drives import write_drive
from service_kit import tus
from service_kit.links import BadLink
from service_kit.object_store import WHEREVER, ObjectStoreServer, all_arrived, is_stored, stored_bytes
from service_kit.packed_drives import packed_drive_of
from service_kit.running import ApiAlone, until
from wayloom.client.api import AnswerError, Api
from wayloom.client.manifests import PackedDrive, pack
from wayloom.client.upload import CONTENT, upload
from wayloom.errors import LogError

MIB = 1 << 20
HEAD = 4096
"""Bytes of the heads and answers of a few requests."""


@pytest.fixture(scope="module", params=WHEREVER)
def alone(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    store = request.getfixturevalue("object_store") if request.param == "objects" else None
    server = ApiAlone(tmp_path_factory.mktemp("server") / "data", store)
    yield server
    server.close()


@pytest.fixture
def http(alone: ApiAlone) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as client:
        yield client


def small_files(folder: Path, count: int, size: int, empty: tuple[int, ...] = ()) -> PackedDrive:
    """A drive of small files of random bytes, some of them empty."""
    folder.mkdir(parents=True, exist_ok=True)
    contents = {f"log/{i:04}": os.urandom(0 if i in empty else size + i) for i in range(count)}
    return packed_drive_of(folder, folder.name, contents)


def check_arrived(server: ApiAlone, drive: PackedDrive) -> None:
    come = all_arrived(server, drive.manifest.drive_id)
    assert come.keys() == drive.sources.keys()
    for path, source in drive.sources.items():
        assert come[path] == source.read_bytes(), path


def begin(http: httpx2.Client, drive: str, *paths: str) -> Any:
    return http.post(f"/v1/drives/{drive}/packs", json={"paths": list(paths)})


def test_small_files_go_as_one_upload_and_arrive_each_in_its_place(alone: ApiAlone, tmp_path: Path) -> None:
    drive = small_files(tmp_path / "many", 300, 5000, empty=(0, 7, 8, 299))
    told: list[str] = []
    link = BadLink(alone.url)
    with Api(link.url) as api:
        assert upload(api, drive, lambda _share, what: told.append(what))["missing"] == []
    link.close()
    assert link.sent < 1.1 * drive.manifest.byte_count + 300 * 200 + HEAD  # the manifest and the pack's list name each file
    assert "300 of 300 files" in told[-1]
    check_arrived(alone, drive)
    assert not list((alone.data / "uploads").glob("*.[0-9]*"))


def test_files_of_a_drive_that_have_arrived_are_not_part_of_its_pack(http: httpx2.Client) -> None:
    drive = tus.register(http, "some there", a=b"aaa", b=b"bb", c=b"c")
    assert tus.create(http, drive, "log/b", 2, b"bb").status_code == 201
    begun = begin(http, drive, "log/c", "log/b", "log/a").json()
    assert (begun["skipped"], begun["length"]) == (["log/b"], 4)
    assert [file["path"] for file in http.get(f"{begun['upload']}/files").json()["files"]] == ["log/c", "log/a"]
    assert tus.patch(http, begun["upload"], 0, b"caaa").headers["Upload-Offset"] == "4"
    assert http.get(f"/v1/drives/{drive}").json()["state"] != "uploading"
    assert begin(http, drive, "log/a").json() == {"upload": None, "length": 0, "skipped": ["log/a"]}


def test_a_pack_of_files_that_the_manifest_does_not_name_is_refused(http: httpx2.Client) -> None:
    drive = tus.register(http, "unknown files", a=b"aaa")
    assert begin(http, drive, "log/a", "log/b").status_code == 404
    assert begin(http, drive, "log/a", "log/a").status_code == 409
    assert begin(http, drive).status_code == 422


def test_whole_files_are_stored_though_the_request_breaks_and_the_rest_goes_on_at_the_last_byte(
    http: httpx2.Client, alone: ApiAlone
) -> None:
    contents = {name: os.urandom(MIB - 1000) for name in "abcd"}
    drive = tus.register(http, "broken", **contents)
    address = begin(http, drive, *(f"log/{name}" for name in "abcd")).json()["upload"]
    stream = b"".join(contents.values())
    before = tus.received(alone.url)

    def breaks() -> Iterator[bytes]:
        yield stream[: 5 * MIB // 2]
        until(lambda: is_stored(alone, address, 2 * MIB) and tus.received(alone.url) - before >= 2 * MIB)
        raise ConnectionError

    with pytest.raises(ConnectionError):
        tus.patch(http, address, 0, breaks())
    offset = tus.offset(http, address)
    assert 2 * MIB <= offset <= 5 * MIB // 2
    assert sorted(all_arrived(alone, drive)) == ["log/a", "log/b"]
    assert tus.patch(http, address, offset, stream[offset:]).status_code == 204
    assert all_arrived(alone, drive) == {f"log/{name}": content for name, content in contents.items()}


def test_a_flipped_byte_in_a_pack_has_no_more_than_a_chunk_sent_again(alone: ApiAlone, tmp_path: Path) -> None:
    drive = small_files(tmp_path / "flipped", 60, 200_000)
    link = BadLink(alone.url, flip_at=7 * MIB)
    with Api(link.url) as api:
        assert upload(api, drive, chunk=2 * MIB)["missing"] == []
    link.close()
    assert drive.manifest.byte_count < link.sent < drive.manifest.byte_count + 2 * MIB + MIB // 4
    check_arrived(alone, drive)


def test_a_file_of_a_pack_that_is_not_the_one_announced_is_refused_and_those_before_it_stay(
    http: httpx2.Client, alone: ApiAlone
) -> None:
    drive = tus.register(http, "wrong file", a=b"aaa", b=b"bbb")
    address = begin(http, drive, "log/a", "log/b").json()["upload"]
    answer = tus.patch(http, address, 0, b"aaaxxx")
    assert (answer.status_code, answer.json()["code"]) == (460, "file-mismatch")
    assert "log/b" in answer.json()["detail"]
    assert tus.offset(http, address) == 3
    assert all_arrived(alone, drive) == {"log/a": b"aaa"}
    assert tus.patch(http, address, 3, b"bbb").status_code == 204


def test_a_file_of_a_pack_that_was_rewritten_after_it_was_announced_is_said(alone: ApiAlone, tmp_path: Path) -> None:
    drive = small_files(tmp_path / "rewritten", 5, 1000)
    drive.sources["log/0003"].write_bytes(os.urandom(1003))
    with Api(alone.url) as api, pytest.raises(LogError, match="changed since"):
        upload(api, drive)


@pytest.mark.parametrize("break_after", [MIB, MIB // 2])
def test_a_link_that_breaks_again_and_again_brings_the_pack_all_the_same(alone: ApiAlone, tmp_path: Path, break_after: int) -> None:
    drive = small_files(tmp_path / f"breaks {break_after}", 80, 100_000)
    link = BadLink(alone.url, break_after=break_after)
    with Api(link.url) as api:
        assert upload(api, drive)["missing"] == []
    link.close()
    size = drive.manifest.byte_count
    assert link.broken >= size // break_after - 1
    assert link.sent < 1.5 * size + link.broken * MIB // 4
    check_arrived(alone, drive)


@pytest.mark.parametrize("wherever", WHEREVER)
def test_a_server_and_a_client_that_are_killed_in_the_middle_of_a_pack_go_on(
    tmp_path: Path, object_store: ObjectStoreServer, wherever: str
) -> None:
    server = ApiAlone(tmp_path / "data", object_store if wherever == "objects" else None)
    drive = small_files(tmp_path / "killed", 100, 100_000)
    stream = b"".join(source.read_bytes() for source in drive.sources.values())
    killed = threading.Event()

    def stalls() -> Iterator[bytes]:
        yield stream[: 4 * MIB]
        killed.wait(60)

    def send() -> None:
        with httpx2.Client(base_url=server.url, timeout=30.0, trust_env=False) as http, pytest.raises(httpx2.HTTPError):
            tus.patch(http, address, 0, stalls())

    try:
        with httpx2.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
            drive_id = http.post("/v1/drives", json=drive.manifest.model_dump(mode="json", exclude_none=True)).json()["id"]
            address = begin(http, drive_id, *drive.sources).json()["upload"]
        sender = threading.Thread(target=send)
        sender.start()
        until(lambda: is_stored(server, address, 4 * MIB))
        server.kill()
        killed.set()
        sender.join()
        server.start()
        link = BadLink(server.url)
        with Api(link.url) as api:
            assert upload(api, drive)["missing"] == []
        link.close()
        assert link.sent < len(stream) - 4 * MIB + 100 * 200 + HEAD
        check_arrived(server, drive)
    finally:
        server.close()


@pytest.mark.parametrize("alone", ["folder"], indirect=True)
def test_whole_files_of_a_pack_that_a_power_cut_has_spoilt_are_sent_again(http: httpx2.Client, alone: ApiAlone) -> None:
    drive = tus.register(http, "spoilt", a=b"aaa", b=b"bbb", c=b"ccc")
    address = begin(http, drive, "log/a", "log/b", "log/c").json()["upload"]
    stem = alone.data / "uploads" / address.rpartition("/")[2]
    stem.with_suffix(".0").write_bytes(b"aaa")
    stem.with_suffix(".1").write_bytes(bytes(3))
    assert tus.offset(http, address) == 3
    assert tus.patch(http, address, 3, b"bbbccc").status_code == 204


def test_a_pack_that_is_given_up_leaves_nothing_but_its_whole_files(http: httpx2.Client, alone: ApiAlone) -> None:
    drive = tus.register(http, "given up", a=b"aaa", b=b"bbb")
    address = begin(http, drive, "log/a", "log/b").json()["upload"]
    assert tus.patch(http, address, 0, b"aaab").status_code == 204
    assert http.delete(address, headers=tus.V).status_code == 204
    assert stored_bytes(alone, address) == (0 if alone.objects is None else 3)
    assert [file["path"] for file in _register_again(http, "given up", a=b"aaa", b=b"bbb")["missing"]] == ["log/b"]


def _register_again(http: httpx2.Client, name: str, **contents: bytes) -> Any:
    files = [
        {"path": f"log/{path}", "size": len(data), "sha256": hashlib.sha256(data).hexdigest()} for path, data in contents.items()
    ]
    return http.post("/v1/drives", json={"name": name, "files": files}).json()


def test_a_server_that_knows_no_packs_gets_the_files_one_by_one(alone: ApiAlone, tmp_path: Path) -> None:
    class OlderServer(Api):
        """As the server was before packs: its registration does not name them, and their address is unknown."""

        def json(self, method: str, path: str, **request: Any) -> Any:
            return {name: value for name, value in super().json(method, path, **request).items() if name != "packs"}

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            if path.endswith("/packs"):
                raise AnswerError(404, "not-found", "Not Found")
            return super().once(method, path, **request)

    drive = small_files(tmp_path / "older", 5, 1000)
    with OlderServer(alone.url) as api:
        assert upload(api, drive)["missing"] == []
    check_arrived(alone, drive)


@pytest.mark.parametrize("status", [404, 410])
def test_a_pack_that_the_server_has_lost_is_gone_on_without(
    http: httpx2.Client, alone: ApiAlone, tmp_path: Path, status: int
) -> None:
    class Forgetful(Api):
        """A server that names the pack, and does not know its files any more."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            if path.endswith("/files"):
                raise AnswerError(status, "not-found", "the pack's index is gone")
            return super().once(method, path, **request)

    drive = small_files(tmp_path / f"lost {status}", 5, 1000)
    with Forgetful(alone.url) as api:
        registered = api.json("POST", "/v1/drives", json=drive.manifest.model_dump(mode="json", exclude_none=True))
        assert begin(http, registered["id"], *drive.sources).status_code == 201
        assert upload(api, drive)["missing"] == []
    check_arrived(alone, drive)


def test_files_that_another_client_has_sent_meanwhile_are_counted(alone: ApiAlone, tmp_path: Path) -> None:
    drive = small_files(tmp_path / "meanwhile", 5, 1000)
    told: list[str] = []

    class OtherClientFirst(Api):
        """Another client sends two of the files just before the pack is made."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            if path.endswith("/packs"):
                address = super().once(method, path, json={"paths": ["log/0001", "log/0003"]}).json()["upload"]
                content = b"".join(drive.sources[f"log/{name}"].read_bytes() for name in ("0001", "0003"))
                super().once("PATCH", address, headers=tus.V | CONTENT | {"Upload-Offset": "0"}, content=content)
            return super().once(method, path, **request)

    with OtherClientFirst(alone.url) as api:
        upload(api, drive, lambda _share, what: told.append(what))
    before_the_server_was_asked = told[-2]
    assert "5 of 5 files" in before_the_server_was_asked


@pytest.mark.real_data
def test_a_log_with_a_link_that_leads_out_of_its_folder_is_refused(clip_a: Path, tmp_path: Path) -> None:
    few = tmp_path / "few"
    for side in ("image_0", "image_1"):
        (few / side).mkdir(parents=True)
        for name in sorted(os.listdir(clip_a / side))[:4]:
            (few / side / name).write_bytes((clip_a / side / name).read_bytes())
    (few / "calib.txt").write_bytes((clip_a / "calib.txt").read_bytes())
    (few / "times.txt").write_text("".join((clip_a / "times.txt").read_text().splitlines(keepends=True)[:4]))
    assert len(pack(few).sources) == 10
    (few / "image_0" / name).unlink(missing_ok=True)
    last = sorted((few / "image_1").iterdir())[-1]
    (tmp_path / "elsewhere.png").write_bytes(last.read_bytes())
    (few / "image_0" / last.name).symlink_to(tmp_path / "elsewhere.png")
    with pytest.raises(LogError, match="leads out of"):
        pack(few)


def test_a_lent_gnss_log_with_a_link_that_leads_out_of_its_folder_is_refused(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "log", "kitti-odometry", gnss=False)
    lender = write_drive(tmp_path / "lender", "kitti-raw")
    packet = lender / "oxts/data/0000000002.txt"
    assert any(name.endswith(packet.name) for name in pack(drive, gnss=lender).sources)
    packet.rename(tmp_path / "secret.txt")
    packet.symlink_to(tmp_path / "secret.txt")
    with pytest.raises(LogError, match=r"0000000002\.txt: .*leads out of") as refused:
        pack(drive, gnss=lender)
    assert refused.value.reason == "file.outside"
