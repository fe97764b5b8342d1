"""What a drive has led to, over HTTP: report, poses, points, pictures of keyframes, log; warnings, list, fleet."""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import httpx2
import numpy as np
import pytest

from service_kit.running import ApiAlone
from service_kit.tus import create, register
from wayloom.config.classes import CLASS_ID, PALETTE
from wayloom.files.trajectory_files import read_tum
from wayloom.store import drives, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.history import note_event
from wayloom.store.tables.drives import DriveEstimate
from wayloom_services.keyframes import HELD
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import placed

CAMERA = {"width": 640, "height": 320, "fx": 300.0, "fy": 300.0, "cx": 320.0, "cy": 160.0}
LOOKS_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A level camera in a frame whose third axis is up."""
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="80" height="40"></svg>'
QUALITY = {"fixes": None, "bursts": [], "receiver": None, "scale": None, "drift": None, "loops": None, "pictures": {"track": SVG}}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ApiAlone, str]]:
    """A service, and a drive with one submap, one person in it, and a report."""
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data")
    with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
        drive = register(http, "street seven", a=b"bytes of a log")
        create(http, drive, "log/a", 14, b"bytes of a log")
    blobs, database = BlobStore(alone.data / "blobs"), Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    item = placed(drive, 7, classes=(0, CLASS_ID["person"]))
    item.submap.T_submap_cam[0, :3, :3] = LOOKS_ALONG_X
    blobs.put(item.submap.encoded)
    with database.write() as session:
        maps.place_submaps(session, drive, [submap_row(drive, "city", 0, item)])
        row = drives.get(session, drive)
        digest = blobs.put(json.dumps(QUALITY).encode())
        row.facts = {"log": {"camera": CAMERA, "missing": [], "frames": {"gaps": []}}, "quality": digest}
        for what, text in (("begun", ""), ("failed", "no luck")):
            note_event(session, drive, "odometry", what, attempt=1, text=text, worker="host/boot|77|1")
        for truth_s in (60.0, 100.0, 110.0, 140.0):
            told_s = {"expected_s": 100.0, "low_s": 70.0, "high_s": 150.0, "truth_s": truth_s}
            session.add(DriveEstimate(drive_id=drive, at=1.0, stage="ground", rough=False, **told_s))
    database.close()
    yield alone, drive
    alone.close()


def get(kept: tuple[ApiAlone, str], path: str) -> httpx2.Response:
    return httpx2.get(f"{kept[0].url}/v1/drives/{kept[1]}/{path}")


def test_the_report_is_one_page_that_loads_and_runs_nothing(kept: tuple[ApiAlone, str]) -> None:
    answer = get(kept, "report.html")
    assert answer.headers["content-type"].startswith("text/html")
    policies = answer.headers.get_list("content-security-policy")
    assert len(policies) == 1
    assert "default-src 'none'" in policies[0]
    assert "sandbox" in policies[0]
    assert "street seven" in answer.text
    assert "<script" not in answer.text


def test_poses_of_keyframes_are_read_as_tum(kept: tuple[ApiAlone, str], tmp_path: Path) -> None:
    file = tmp_path / "poses.tum"
    file.write_bytes(get(kept, "trajectory.tum").content)
    t_ns, T = read_tum(file)
    assert t_ns.tolist() == [0, 10**9]
    assert np.linalg.norm(T[1, :3, 3] - T[0, :3, 3]) == pytest.approx(30.0)


def test_the_cloud_is_a_ply_of_all_points_but_persons(kept: tuple[ApiAlone, str]) -> None:
    answer = get(kept, "cloud.ply")
    assert 'filename="street-seven.ply"' in answer.headers["content-disposition"]
    shown = int((placed(kept[1], 7, classes=(0, CLASS_ID["person"])).submap.label == 0).sum())
    assert 0 < shown < 500
    assert f"element vertex {shown}\n".encode() in answer.content


def test_the_log_is_a_tar_of_what_was_sent(kept: tuple[ApiAlone, str]) -> None:
    with tarfile.open(fileobj=io.BytesIO(get(kept, "log.tar").content)) as archive:
        assert archive.getnames() == ["log/a"]
        content = archive.extractfile("log/a")
        assert content is not None
        assert content.read() == b"bytes of a log"


def test_keyframes_are_listed_and_their_points_drawn_without_persons(kept: tuple[ApiAlone, str]) -> None:
    listed = get(kept, "keyframes").json()
    assert [(one["number"], one["frame"], one["points"]) for one in listed["keyframes"]] == [(0, 0, 500), (1, 1, 0)]
    assert listed["images"] == "kept"
    answer = get(kept, "keyframes/0/points.webp")
    assert answer.headers["content-type"] == "image/webp"
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert picture.shape == (480, 960, 3)
    near = {label: int((np.abs(picture.astype(int) - PALETTE[label]).max(axis=2) < 40).sum()) for label in (0, CLASS_ID["person"])}
    assert near[0] > 100
    assert near[CLASS_ID["person"]] == 0
    assert get(kept, "keyframes/2/points.webp").status_code == 404
    assert get(kept, "keyframes/0/image.webp").status_code == 404  # its labels are not there: no stage has run


def test_the_picture_of_a_keyframe_opens_its_own_submap_alone_once_the_list_is_known(kept: tuple[ApiAlone, str]) -> None:
    """Scrubbing would be quadratic otherwise: the submaps before it are gone from the store here, and from memory."""
    data = kept[0].data
    with httpx2.Client(base_url=kept[0].url) as http:
        drive = register(http, "a long one", a=b"bytes of a long log")
        blobs, database = BlobStore(data / "blobs"), Database(f"sqlite:///{data / 'wayloom.db'}")
        items = [placed(drive, seed) for seed in range(100, 101 + HELD + 1)]
        digests = [blobs.put(item.submap.encoded) for item in items]
        with database.write() as session:
            maps.place_submaps(session, drive, [submap_row(drive, "city", k, item) for k, item in enumerate(items)])
            drives.get(session, drive).facts = {"log": {"camera": CAMERA}}
        database.close()
        assert len(http.get(f"/v1/drives/{drive}/keyframes").json()["keyframes"]) == 2 * len(items)
        for digest in digests[:-1]:
            blobs.delete(digest)
        assert http.get(f"/v1/drives/{drive}/keyframes/{2 * len(items) - 1}/points.webp").status_code == 200
        assert http.get(f"/v1/drives/{drive}/keyframes/0/points.webp").status_code == 404


def test_what_needs_images_is_refused_once_they_are_deleted(kept: tuple[ApiAlone, str]) -> None:
    set_images(kept, "deleted")
    try:
        for path in ("log.tar", "keyframes/0/image.webp"):
            answer = get(kept, path)
            assert (answer.status_code, answer.json()["code"]) == (409, "images-deleted")
        assert get(kept, "keyframes/0/points.webp").status_code == 200
    finally:
        set_images(kept, "kept")


@pytest.mark.parametrize(
    "path",
    [
        "report.html", "history", "trajectory.tum", "cloud.ply", "log.tar", "archive.zip", "keyframes", "keyframes/0/points.webp",
        "keyframes/0/image.webp", "track", "preview.png", "quality", "quality/track.svg", "runs",
    ],
)  # fmt: skip
def test_a_drive_that_is_being_removed_hands_nothing_out(kept: tuple[ApiAlone, str], path: str) -> None:
    before = set_state(kept, "removing")
    try:
        answer = get(kept, path)
        assert (answer.status_code, answer.json()["code"]) == (404, "not-found")
        assert answer.json()["detail"] == f"drive {kept[1][:12]} is being removed"
        assert httpx2.get(f"{kept[0].url}/v1/drives/{kept[1]}").json()["state"] == "removing"
    finally:
        set_state(kept, before)


def set_state(kept: tuple[ApiAlone, str], state: str) -> str:
    """Returns the one before."""
    database = Database(f"sqlite:///{kept[0].data / 'wayloom.db'}")
    with database.write() as session:
        row = drives.get(session, kept[1])
        before, row.state = row.state, state
    database.close()
    return before


def set_images(kept: tuple[ApiAlone, str], state: str) -> None:
    database = Database(f"sqlite:///{kept[0].data / 'wayloom.db'}")
    with database.write() as session:
        drives.get(session, kept[1]).images = state
    database.close()


def test_the_history_tells_every_attempt_newest_first(kept: tuple[ApiAlone, str]) -> None:
    told = get(kept, "history").json()
    assert [(one["what"], one["text"], one["worker"]) for one in told["events"]] == [
        ("failed", "no luck", "host pid 77"), ("begun", "", "host pid 77"),
    ]  # fmt: skip
    first = get(kept, "history?limit=1").json()
    assert [one["what"] for one in get(kept, f"history?before={first['next']}").json()["events"]] == ["begun"]


def test_a_drive_without_results_says_so(kept: tuple[ApiAlone, str]) -> None:
    with httpx2.Client(base_url=kept[0].url) as http:
        other = register(http, "not yet", a=b"other bytes")
        for path in ("report.html", "trajectory.tum", "cloud.ply"):
            answer = http.get(f"/v1/drives/{other}/{path}")
            assert (answer.status_code, answer.json()["code"]) == (404, "not-found")
        assert http.get(f"/v1/drives/{other}/keyframes").json()["keyframes"] == []


def test_the_fleet_tells_queues_storage_and_version(kept: tuple[ApiAlone, str]) -> None:
    told: dict[str, Any] = httpx2.get(f"{kept[0].url}/v1/fleet").json()
    queues = {one["name"]: one["queued"] for one in told["queues"]}
    assert queues["ingest"] >= 1  # the drive of this file waits for a worker, which there is none of
    assert 0 < told["storage"]["free"] < told["storage"]["total"]
    assert told["work"] == []


def test_the_fleet_and_the_metrics_tell_how_often_the_time_that_was_told_was_true(kept: tuple[ApiAlone, str]) -> None:
    told = httpx2.get(f"{kept[0].url}/v1/fleet").json()["eta"]
    assert told == {"nominal": 0.8, "measured": 0.75, "judged": 4, "stages": [{"stage": "ground", "judged": 4, "within": 3}]}
    text = httpx2.get(f"{kept[0].url}/metrics").text
    assert 'wayloom_eta_judged_total{stage="ground"} 4.0' in text
    assert 'wayloom_eta_within_total{stage="ground"} 3.0' in text
