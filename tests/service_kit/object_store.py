"""A real S3 server on this machine (moto), and where the files of drives lie of a server that keeps them there or in its folder."""

import os
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Final
from unittest.mock import patch

from wayloom.store.database import Database
from wayloom.store.drive_files import DriveFiles
from wayloom.store.folders import Folders
from wayloom.store.manifest import FOLDERS
from wayloom.store.objects import Objects
from wayloom.store.receiving import parts
from wayloom.store.receiving.part_writer import PART_BYTES

if TYPE_CHECKING:
    from service_kit.running import ApiAlone

BUCKET: Final = "drives"
WHEREVER: Final = ("folder", "objects")
"""Parameters of tests that hold wherever uploads are kept."""
MOST: Final = 1 << 40


class ObjectStoreServer:
    """moto's S3 server, with one bucket. What it holds is gone with it."""

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self._port)]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.variables = {
            "AWS_ENDPOINT": f"http://127.0.0.1:{self._port}", "AWS_ALLOW_HTTP": "true", "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": "anybody", "AWS_SECRET_ACCESS_KEY": "nothing",
        }  # fmt: skip
        deadline = time.monotonic() + 60
        while not self._answers():
            assert time.monotonic() < deadline, "moto did not start"
            time.sleep(0.1)

    def new_url(self) -> str:
        """A prefix that nothing has been stored under."""
        return f"s3://{BUCKET}/{uuid.uuid4().hex}"

    def open(self, url: str) -> Objects:
        """As a process of the service opens it."""
        with patch.dict(os.environ, self.variables):
            return Objects(url)

    def close(self) -> None:
        """kill -9."""
        self._process.kill()
        self._process.wait()

    def _answers(self) -> bool:
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/{BUCKET}", method="PUT")
        try:
            urllib.request.urlopen(request, timeout=5).close()
        except OSError:
            return False
        return True


def database_of(server: "ApiAlone") -> Database:
    """The database of a server on SQLite."""
    return Database(f"sqlite:///{server.data / 'wayloom.db'}")


def arrived(server: "ApiAlone", drive: str, path: str) -> bytes:
    """A file of a drive that has arrived."""
    return all_arrived(server, drive)[path]


def all_arrived(server: "ApiAlone", drive: str) -> dict[str, bytes]:
    """The files of a drive that have arrived, from the drive's folder, or from the object store as a worker fetches them."""
    if server.objects is None:
        return _files_below(server.data / "drives" / drive)
    with tempfile.TemporaryDirectory() as folder:
        folders, database = Folders(Path(folder)), database_of(server)
        with DriveFiles(folders, database, server.objects, MOST).held(drive, lambda _share, _what: None):
            return _files_below(folders.drive(drive))


def _files_below(home: Path) -> dict[str, bytes]:
    return {
        path.relative_to(home).as_posix(): path.read_bytes()
        for name in FOLDERS
        for path in (home / name).rglob("*")
        if path.is_file()
    }


def stored_bytes(server: "ApiAlone", address: str) -> int:
    """How much of an upload is stored, whatever the server says."""
    upload_id = address.rpartition("/")[2]
    if server.objects is None:
        return sum(path.stat().st_size for path in (server.data / "uploads").glob(f"{upload_id}.[0-9p]*") if path.suffix != ".pack")
    with database_of(server).read() as session:
        return parts.end_of(session, upload_id)


def is_stored(server: "ApiAlone", address: str, least: int, start: int = 0) -> bool:
    """Whether so much is stored of an upload that was sent from `start` on: in an object store, so many whole parts."""
    if server.objects is not None:
        least = start + (least - start) // PART_BYTES * PART_BYTES
    return stored_bytes(server, address) >= least
