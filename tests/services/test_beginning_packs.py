"""Packs that are begun: counted once, and left behind by nobody who could not write down what they are made of."""

from contextlib import closing
from pathlib import Path

import httpx2
from sqlalchemy import func, select

from service_kit import tus
from service_kit.guarded import OURS, Guarded, bearer
from service_kit.running import ApiAlone
from wayloom.config.roles import Role
from wayloom.store import packs, uploads
from wayloom.store.database import now_s
from wayloom.store.packs import LARGEST_PACKED
from wayloom.store.tables.drives import Upload

OUT_OF_SPACE = {"WAYLOOM_MIN_FREE_BYTES": str(1 << 60)}


def begin(http: httpx2.Client, drive: str, key: str | None = None) -> httpx2.Response:
    return http.post(f"/v1/drives/{drive}/packs", json={"paths": ["log/a"]}, headers=bearer(key))


def packs_of(http: httpx2.Client, name: str, **contents: bytes) -> list[str]:
    """Those that a registration lists."""
    registration = http.post("/v1/drives", json=tus.manifest(name, **contents)).json()
    return [pack["upload"] for pack in registration["packs"]]


def test_a_pack_counts_once_in_what_an_owner_may_have_open(tmp_path: Path) -> None:
    with closing(Guarded(tmp_path / "data", WAYLOOM_ACCESS__OPEN_BYTES="15")) as service:
        ours = service.key(Role.VEHICLE, OURS)
        drive = service.drive(ours)  # of 10 bytes
        assert begin(service.http, drive, ours).status_code == 201
        assert (begin(service.http, drive, ours).status_code, begin(service.http, "f" * 64, ours).status_code) == (429, 404)


def test_a_pack_whose_server_died_before_its_index_was_written_counts_for_minutes_and_not_for_days(tmp_path: Path) -> None:
    with closing(Guarded(tmp_path / "data")) as service:
        ours = service.key(Role.VEHICLE, OURS)
        drive = service.drive(ours)
        with service.database.write() as session:
            lost = packs.create(session, drive, packs.lacking(session, drive, ["log/a"]))
            assert lost.expires_at - now_s(session) <= packs.UNINDEXED_S
        address = begin(service.http, drive, ours).json()["upload"]
        with service.database.read() as session:
            begun = uploads.find(session, address.rpartition("/")[2])
            assert begun.expires_at - now_s(session) > 100 * packs.UNINDEXED_S


def test_a_pack_for_which_there_is_no_space_leaves_no_row(tmp_path: Path) -> None:
    with closing(Guarded(tmp_path / "data", **OUT_OF_SPACE)) as service:
        ours = service.key(Role.VEHICLE, OURS)
        assert begin(service.http, service.drive(ours), ours).status_code == 507
        with service.database.read() as session:
            assert session.scalar(select(func.count()).select_from(Upload)) == 0


def test_a_registration_lists_no_pack_whose_index_was_never_written(http: httpx2.Client, api_process: ApiAlone) -> None:
    name = "a pack without an index"
    drive = tus.register(http, name, a=b"aaa")
    lost, good = (begin(http, drive).json()["upload"] for _ in range(2))
    (api_process.data / "uploads" / f"{lost.rpartition('/')[2]}.pack").unlink()  # as if the server had died before
    assert packs_of(http, name, a=b"aaa") == [good]
    assert tus.patch(http, good, 0, b"aaa").status_code == 204


def test_a_file_that_is_too_large_for_a_pack_is_named(http: httpx2.Client) -> None:
    files = [{"path": f"log/{name}", "size": size, "sha256": "0" * 64} for name, size in (("a", 1), ("b", LARGEST_PACKED + 1))]
    drive = http.post("/v1/drives", json={"name": "large", "files": files}).json()["id"]
    refused = http.post(f"/v1/drives/{drive}/packs", json={"paths": ["log/a", "log/b"]})
    assert (refused.status_code, "log/b" in refused.json()["detail"]) == (409, True)
    assert http.post(f"/v1/drives/{drive}/packs", json={"paths": ["log/a"]}).status_code == 201
