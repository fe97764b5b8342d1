"""Submaps are handed out by their digests only, as long as their drive is there, and without persons."""

from typing import Any

import httpx2
import pytest

from service_kit.running import ApiAlone
from service_kit.tus import register
from wayloom.config.classes import CLASS_ID
from wayloom.store import drives, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.submaps.submap import Submap, decode_submap
from wayloom_services import submap_points
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import placed


def kept(api: ApiAlone, drive_id: str, item: Any) -> str:
    """The submap, in the store and in a row."""
    digest = BlobStore(api.data / "blobs").put(item.submap.encoded)
    database = Database(f"sqlite:///{api.data / 'wayloom.db'}")
    with database.write() as session:
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
    database.close()
    return digest


def test_a_submap_with_persons_of_an_older_release_is_withheld(http: httpx2.Client, api_process: ApiAlone) -> None:
    drive_id = register(http, "with persons", a=b"person")
    item = placed(drive_id, 77, classes=(0, CLASS_ID["person"]))
    answer = http.get(f"/v1/submaps/{kept(api_process, drive_id, item)}")
    assert (answer.status_code, answer.json()["code"]) == (409, "withheld")


def test_a_blob_that_is_no_submap_of_a_drive_is_not_handed_out(http: httpx2.Client, api_process: ApiAlone) -> None:
    drive_id = register(http, "goes", a=b"goes")
    digest = kept(api_process, drive_id, placed(drive_id, 78))
    other = BlobStore(api_process.data / "blobs").put(b"evidence of a rig")
    assert http.get(f"/v1/submaps/{digest}").status_code == 200
    assert http.get(f"/v1/submaps/{other}").status_code == 404
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        drives.request_removal(session, drive_id)
    database.close()
    assert http.get(f"/v1/submaps/{digest}").status_code == 404


def test_a_submap_that_shows_nobody_is_looked_through_once(monkeypatch: pytest.MonkeyPatch) -> None:
    read = []

    def decoding(content: bytes, digest: str) -> Submap:
        read.append(digest)
        return decode_submap(content, digest)

    monkeypatch.setattr(submap_points, "decode_submap", decoding)
    good, bad = placed("d" * 64, 79).submap, placed("d" * 64, 80, classes=(0, CLASS_ID["person"])).submap
    for _ in range(2):
        assert submap_points._checked(good.encoded, good.digest) == good.encoded
        with pytest.raises(submap_points.WithheldError):
            submap_points._checked(bad.encoded, bad.digest)
    assert read == [good.digest, bad.digest, bad.digest]
