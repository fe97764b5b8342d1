"""Resumable, parallel upload of one drive (tus protocol), continued where the server's stored bytes end."""

import base64
import hashlib
import threading
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, Final

from wayloom.client.api import RETRIED_STATUS, AnswerError, Api
from wayloom.client.manifests import PackedDrive
from wayloom.config.backoff import Backoff
from wayloom.config.progress import Progress, silent
from wayloom.errors import LogError, ServiceError

CHUNK: Final = 16 << 20
"""Bytes of one PATCH. Smaller chunks cost time, larger ones are lost with their checksum when a link breaks."""
CONNECTIONS: Final = 4
TUS: Final = {"Tus-Resumable": "1.0.0"}
CONTENT: Final = {"Content-Type": "application/offset+octet-stream"}
RETRIES: Final = Backoff(first_s=0.125, longest_s=16.0, tries=10)
"""Of one file."""
ROUNDS: Final = 3
"""How often the server is asked what it lacks: a file that was damaged on the way is sent again."""


class UploadStopped(Exception):  # noqa: N818 - no error: another file's upload has failed and this one ends
    """The upload is over for another reason."""


def upload(
    api: Api, packed_drive: PackedDrive, progress: Progress = silent, connections: int = CONNECTIONS, chunk: int = CHUNK
) -> dict[str, Any]:
    """Send what the server lacks of the drive and return its registration.

    Running it again after any interruption continues; running it for a drive that is complete sends nothing.
    Raises LogError when a file changed on the way, ServiceError when the server stays away or refuses.
    """
    manifest = packed_drive.manifest.model_dump(mode="json", exclude_none=True)
    total = packed_drive.manifest.byte_count
    counter = _Counter(total, progress)
    for _ in range(ROUNDS):
        registration: dict[str, Any] = api.json("POST", "/v1/drives", json=manifest)
        missing = registration["missing"]
        counter.set(total - sum(file["size"] - file["offset"] for file in missing))
        if not missing:
            return registration
        _send_all(api, packed_drive, registration["id"], missing, counter, connections, chunk)
    registration = api.json("POST", "/v1/drives", json=manifest)
    if registration["missing"]:
        raise ServiceError(
            f"{len(registration['missing'])} files did not arrive whole, the first is {registration['missing'][0]['path']}"
        )
    counter.set(total)
    return registration


class _Counter:
    """Bytes that the server has, counted from several threads. Bytes that were lost on the way do not let the share fall."""

    def __init__(self, total: int, progress: Progress) -> None:
        self._done, self._total, self._progress, self._share = 0, total, progress, 0.0
        self._lock = threading.Lock()

    def set(self, done: int) -> None:
        with self._lock:
            self._done = done
            self._tell()

    def add(self, count: int) -> None:
        with self._lock:
            self._done += count
            self._tell()

    def _tell(self) -> None:
        self._share = max(self._share, min(1.0, self._done / self._total) if self._total else 1.0)
        self._progress(self._share, f"{self._done / 1e6:.1f} of {self._total / 1e6:.1f} MB sent")


def _send_all(
    api: Api,
    packed_drive: PackedDrive,
    drive_id: str,
    missing: list[dict[str, Any]],
    counter: _Counter,
    connections: int,
    chunk: int,
) -> None:
    over = threading.Event()

    def one(file: dict[str, Any]) -> None:
        _send_file(api, drive_id, file, packed_drive.sources[file["path"]], counter, over, chunk)

    with ThreadPoolExecutor(connections) as pool:
        futures = [pool.submit(one, file) for file in missing]
        try:
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            over.set()
            pool.shutdown(cancel_futures=True)
    for future in done:
        error = future.exception()
        if error is not None and not isinstance(error, UploadStopped):
            raise error


def _send_file(
    api: Api, drive_id: str, file: dict[str, Any], source: Path, counter: _Counter, over: threading.Event, chunk: int
) -> None:
    """One file from where the server has it, each chunk with its SHA-256, again after every interruption."""
    address: str | None = file["upload"]
    offset = int(file["offset"])
    interrupted = False
    for is_last in RETRIES.attempts(over.wait):
        if interrupted and address is not None:
            address, known = _continue_at(api, address, offset)
            counter.add(known - offset)
            offset = known
        try:
            while True:
                if over.is_set():
                    raise UploadStopped
                content = _read(source, offset, min(chunk, file["size"] - offset), file["size"])
                address, new_offset = _send_chunk(api, drive_id, file, address, offset, content)
                counter.add(new_offset - offset)
                offset = new_offset
                if offset == file["size"]:  # an empty chunk at the end finishes a file that a killed server had not verified yet
                    return
        except ServiceError as error:
            if isinstance(error, AnswerError):
                if error.status == 409 and error.code == "conflict":
                    return  # complete already, by another client
                if (error.status in (404, 410) and address is not None) or error.status == 460:
                    counter.add(-offset)
                    address, offset = None, 0  # dropped by the server: from the beginning
                elif error.status != 409 and error.status not in RETRIED_STATUS:
                    raise
            if is_last:
                raise
            interrupted = True


def _send_chunk(api: Api, drive_id: str, file: dict[str, Any], address: str | None, offset: int, content: bytes) -> tuple[str, int]:
    """The upload's address and its offset after this chunk."""
    headers = {**TUS, **CONTENT, "Upload-Checksum": f"sha256 {_base64(hashlib.sha256(content).digest())}"}
    if address is None:
        named = f"drive {_base64(drive_id.encode())},path {_base64(file['path'].encode())}"
        headers |= {"Upload-Length": str(file["size"]), "Upload-Metadata": named}
        response = api.once("POST", "/v1/uploads", headers=headers, content=content)
        return response.headers["Location"], int(response.headers["Upload-Offset"])
    response = api.once("PATCH", address, headers={**headers, "Upload-Offset": str(offset)}, content=content)
    return address, int(response.headers["Upload-Offset"])


def _continue_at(api: Api, address: str, offset: int) -> tuple[str | None, int]:
    """The address and where its stored bytes end; (None, 0) where the server knows it no more; as before while it is away."""
    try:
        return address, int(api.once("HEAD", address, headers=TUS).headers["Upload-Offset"])
    except AnswerError as error:
        return (None, 0) if error.status in (404, 410) else (address, offset)
    except ServiceError:
        return address, offset


def _read(source: Path, offset: int, count: int, size: int) -> bytes:
    """The next bytes of the file. Raises LogError when it is no longer what was announced."""
    try:
        with source.open("rb") as stream:
            stream.seek(offset)
            content = stream.read(count)
    except OSError as error:
        raise LogError(
            f"cannot be read ({error.strerror})", file=source, remedy="check the file and run the command again"
        ) from None
    if len(content) < count:
        raise LogError(f"has become shorter than the {size} bytes announced", file=source, remedy="run the command again")
    return content


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()
