"""One archive of all that a drive has led to, over HTTP and by `wayloom drives download`."""

import io
import json
import tracemalloc
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import cv2
import httpx2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from service_kit.guarded import OURS, THEIRS, Guarded, bearer
from service_kit.running import ApiAlone
from service_kit.tus import create, register
from wayloom.cli.main import app
from wayloom.config.classes import CLASS_ID
from wayloom.config.roles import Role
from wayloom.errors import ConfigError, ServiceError
from wayloom.files.ply import read_ply
from wayloom.files.trajectory_files import read_tum
from wayloom.ground.files import save_sheets
from wayloom.ground.sheet import PIXEL_M, GroundSheet
from wayloom.store import drives, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.history import note_event
from wayloom.store.tables.drives import Job
from wayloom_services.archive.zip_stream import Member, zip_stream
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import placed

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="80" height="40"></svg>'
QUALITY = {"fixes": None, "bursts": [], "receiver": None, "scale": None, "drift": None, "loops": None, "pictures": {"track": SVG}}
GROUND_KEY = "a" * 64
LONG = 64 * 2**20


def sheet_of(submap: str) -> GroundSheet:
    """4 by 6 cells of red ground of which the lower half was seen."""
    colour = np.zeros((8, 12, 3), np.uint8)
    colour[:4, :, 0] = 200
    sharpness = np.where(colour[..., 0] > 0, 90, 0).astype(np.uint8)
    flat, corner = np.zeros((4, 6), np.int16), np.array([10, -20], np.int32)
    return GroundSheet(
        submap, np.eye(4), corner, np.array([10**9, 2 * 10**9]), flat, np.ones((4, 6), np.uint8), np.zeros((4, 6, 3), np.uint16),
        colour, sharpness,
    )  # fmt: skip


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ApiAlone, str]]:
    """A service, and a drive with one submap, a person in it, its ground, and a report."""
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data")
    with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
        drive = register(http, "street seven", a=b"bytes of a log")
        create(http, drive, "log/a", 14, b"bytes of a log")
    blobs, database = BlobStore(alone.data / "blobs"), Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    item = placed(drive, 7, classes=(0, CLASS_ID["person"]))
    blobs.put(item.submap.encoded)
    save_sheets([sheet_of(item.submap.digest)], alone.data / "drives" / drive / "stages" / "ground" / GROUND_KEY)
    with database.write() as session:
        maps.place_submaps(session, drive, [submap_row(drive, "city", 0, item)])
        drives.get(session, drive).facts = {"quality": blobs.put(json.dumps(QUALITY).encode())}
        drives.get(session, drive).track = [[8.4, 49.0], [8.4001, 49.0]]
        job = session.query(Job).filter_by(drive_id=drive, stage="ground").one()
        job.state, job.payload = "done", {"key": GROUND_KEY}
        note_event(session, drive, "odometry", "failed", attempt=1, text="no luck", worker="host/boot|77|1")
    database.close()
    yield alone, drive
    alone.close()


@pytest.fixture(scope="module")
def archive(kept: tuple[ApiAlone, str]) -> zipfile.ZipFile:
    answer = httpx2.get(f"{kept[0].url}/v1/drives/{kept[1]}/archive.zip")
    assert answer.headers["content-type"] == "application/zip"
    assert 'filename="street-seven.zip"' in answer.headers["content-disposition"]
    return zipfile.ZipFile(io.BytesIO(answer.content))


def test_the_archive_holds_what_the_drive_has_led_to_and_is_whole(archive: zipfile.ZipFile) -> None:
    assert archive.testzip() is None
    assert set(archive.namelist()) == {
        "drive.json", "history.json", "track.geojson", "quality.json", "quality/track.svg", "report.html", "trajectory.tum",
        "cloud.ply", "ground/0000.png", "ground/index.json", "README.txt",
    }  # fmt: skip
    assert archive.read("quality/track.svg").decode() == SVG
    assert json.loads(archive.read("quality.json"))["pictures"] == ["track"]
    assert b"street seven" in archive.read("report.html")
    assert json.loads(archive.read("history.json"))[0]["text"] == "no luck"
    assert json.loads(archive.read("track.geojson"))["geometry"]["coordinates"] == [[8.4, 49.0], [8.4001, 49.0]]


def test_its_readme_tells_of_every_file_with_frames_and_units(archive: zipfile.ZipFile) -> None:
    words = archive.read("README.txt").decode()
    for name in set(archive.namelist()) - {"README.txt", "ground/0000.png"}:
        assert f"\n{name}\n" in words
    assert "x east, y north, z up" in " ".join(words.split())
    assert "ground/*.png" in words


def test_its_poses_and_points_are_those_of_the_single_downloads(
    kept: tuple[ApiAlone, str], archive: zipfile.ZipFile, tmp_path: Path
) -> None:
    single = {name: httpx2.get(f"{kept[0].url}/v1/drives/{kept[1]}/{name}").content for name in ("trajectory.tum", "cloud.ply")}
    assert archive.read("trajectory.tum") == single["trajectory.tum"]
    archive.extractall(tmp_path)
    (tmp_path / "single.ply").write_bytes(single["cloud.ply"])
    ours, theirs = read_ply(tmp_path / "cloud.ply"), read_ply(tmp_path / "single.ply")
    np.testing.assert_array_equal(ours.points, theirs.points)
    assert len(ours.points) > 0
    assert CLASS_ID["person"] not in ours.labels
    assert read_tum(tmp_path / "trajectory.tum")[0].tolist() == [0, 10**9]


def test_its_ground_is_a_picture_with_its_place(archive: zipfile.ZipFile) -> None:
    listed = json.loads(archive.read("ground/index.json"))
    assert listed["pixel_m"] == PIXEL_M
    assert [one["file"] for one in listed["sheets"]] == ["ground/0000.png"]
    np.testing.assert_allclose(listed["sheets"][0]["corner_m"], (1.0, -2.0))
    picture = cv2.imdecode(np.frombuffer(archive.read("ground/0000.png"), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (8, 12, 4)
    assert picture[-1, 0].tolist() == [0, 0, 200, 255]  # the sheet's first row is the picture's lowest
    assert picture[0, 0, 3] == 0


def test_a_drive_without_results_has_an_archive_of_its_attempts(kept: tuple[ApiAlone, str]) -> None:
    with httpx2.Client(base_url=kept[0].url) as http:
        other = register(http, "not yet", a=b"other bytes")
        with zipfile.ZipFile(io.BytesIO(http.get(f"/v1/drives/{other}/archive.zip").content)) as found:
            assert found.namelist() == ["drive.json", "history.json", "README.txt"]
        answer = http.get(f"/v1/drives/{'0' * 64}/archive.zip")
        assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


def test_a_vehicle_has_the_archive_of_its_own_drive_and_of_no_other(tmp_path: Path) -> None:
    service = Guarded(tmp_path / "data")
    try:
        ours, theirs = service.key(Role.VEHICLE, OURS), service.key(Role.VEHICLE, THEIRS)
        path = f"/v1/drives/{service.drive(ours)}/archive.zip"
        assert service.http.get(path, headers=bearer(ours)).status_code == 200
        assert service.http.get(path, headers=bearer(theirs)).status_code == 404
        assert service.http.get(path).status_code == 401
    finally:
        service.close()


def test_an_archive_is_made_in_little_memory_however_long_it_is() -> None:
    block = bytes(2**20)
    members = [Member("long", (block for _ in range(LONG // len(block))), packed=False, huge=True)]
    count = 0
    tracemalloc.start()
    try:
        for part in zip_stream(members, 0.0):
            count += len(part)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert count > LONG
    assert peak < LONG / 8


def test_an_archive_that_broke_off_is_no_archive() -> None:
    def broken() -> Iterator[bytes]:
        yield b"some"
        raise RuntimeError("the disk is gone")

    held, stream = io.BytesIO(), zip_stream([Member("a", (b"whole",)), Member("b", broken())], 0.0)
    with pytest.raises(RuntimeError):
        held.writelines(stream)
    assert held.getvalue().startswith(b"PK")
    assert not zipfile.is_zipfile(held)


def download(url: str, drive: str, out: Path) -> Result:
    """`wayloom drives download`, in this process."""
    return CliRunner().invoke(app, ["drives", "download", drive, "--to", url, "--out", str(out)], standalone_mode=False)


def test_the_command_writes_the_archive(kept: tuple[ApiAlone, str], tmp_path: Path) -> None:
    told = download(kept[0].url, kept[1][:8], tmp_path / "seven.zip")
    assert told.exit_code == 0, told.exception
    assert told.stdout.endswith(f"written: {tmp_path / 'seven.zip'}\n")
    assert "street seven: " in told.stderr
    with zipfile.ZipFile(tmp_path / "seven.zip") as found:
        assert "cloud.ply" in found.namelist()
    assert isinstance(download(kept[0].url, kept[1], tmp_path / "seven.tar").exception, ConfigError)


class Breaking(BaseHTTPRequestHandler):
    """A service whose archive breaks off in the middle."""

    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        self.send_response(200)
        if "archive" not in self.path:
            body = json.dumps({"drives": [{"id": "c" * 64, "name": "lost"}], "next_before": None}).encode()
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
            return
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        self.wfile.write(b"4\r\nPK\3\4\r\n")
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Silence."""


def test_a_download_that_breaks_off_leaves_what_was_there_before(tmp_path: Path) -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Breaking)
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        out = tmp_path / "lost.zip"
        out.write_bytes(b"the one before")
        told = download(f"http://127.0.0.1:{server.server_port}", "lost", out)
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
    assert isinstance(told.exception, ServiceError)
    assert "broke off" in str(told.exception)
    assert out.read_bytes() == b"the one before"
    assert [file.name for file in tmp_path.iterdir()] == ["lost.zip"]
