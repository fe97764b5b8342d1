"""Resumable, parallel upload of one drive (tus protocol), continued where the server's stored bytes end."""

import base64
import threading
import time
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from wayloom.client.api import RETRIED_STATUS, AnswerError, Api
from wayloom.client.chunks import FIRST, LARGEST, Chunk, ChunkSize
from wayloom.client.manifests import PackedDrive, hash_file
from wayloom.config.backoff import Backoff
from wayloom.config.progress import Progress, silent
from wayloom.errors import LogError, ServiceError

CONNECTIONS: Final = 4
TUS: Final = {"Tus-Resumable": "1.0.0"}
CONTENT: Final = {"Content-Type": "application/offset+octet-stream"}
RETRIES: Final = Backoff(first_s=0.125, longest_s=16.0, tries=10)
"""Of one file, after failures that brought no byte."""
GOES_ON: Final = frozenset({404, 408, 409, 410, 460})
"""Answers after which the server is asked how far the upload is."""
ROUNDS: Final = 3
"""How often the server is asked what it lacks: a file that was damaged on the way is sent again."""


class UploadStopped(Exception):  # noqa: N818 - no error: another file's upload has failed and this one ends
    """The upload is over for another reason."""


def upload(
    api: Api,
    packed_drive: PackedDrive,
    progress: Progress = silent,
    connections: int = CONNECTIONS,
    chunk: int = LARGEST,
    again: bool = False,
) -> dict[str, Any]:
    """Send what the server lacks of the drive and return its registration.

    Running it again after any interruption continues; running it for a drive that is complete sends nothing.
    chunk : most bytes of one request
    again : send also what the server had and has deleted
    Raises LogError when a file changed on the way, ServiceError when the server stays away or refuses.
    """
    manifest = packed_drive.manifest.model_dump(mode="json", exclude_none=True)
    total = packed_drive.manifest.byte_count
    counter = _Counter(total, progress)
    address = "/v1/drives?again=true" if again else "/v1/drives"
    for _ in range(ROUNDS):
        registration: dict[str, Any] = api.json("POST", address, json=manifest)
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


@dataclass(frozen=True, slots=True)
class _Sending:
    """What the files of one upload share: the link's chunk size, the counter, and whether it is over."""

    counter: _Counter
    chunk: ChunkSize
    over: threading.Event = field(default_factory=threading.Event)

    def check(self) -> None:
        """Raise UploadStopped when another file's upload has failed."""
        if self.over.is_set():
            raise UploadStopped


def _send_all(
    api: Api,
    packed_drive: PackedDrive,
    drive_id: str,
    missing: list[dict[str, Any]],
    counter: _Counter,
    connections: int,
    chunk: int,
) -> None:
    sending = _Sending(counter, ChunkSize(min(FIRST, chunk), largest=chunk))

    def one(file: dict[str, Any]) -> None:
        _send_file(api, drive_id, file, packed_drive.sources[file["path"]], sending)

    with ThreadPoolExecutor(connections) as pool:
        futures = [pool.submit(one, file) for file in missing]
        try:
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            sending.over.set()
            pool.shutdown(cancel_futures=True)
    for future in done:
        error = future.exception()
        if error is not None and not isinstance(error, UploadStopped):
            raise error


def _send_file(api: Api, drive_id: str, file: dict[str, Any], source: Path, sending: _Sending) -> None:
    """One file from where the server has it, and on from there after every interruption. Only those that bring nothing count."""
    address: str | None = file["upload"]
    offset, failures, unsure = int(file["offset"]), 0, address is not None
    while True:
        sending.check()
        at = offset
        try:
            if unsure:
                address, offset = _continue_at(api, address, at)
                sending.counter.add(offset - at)
            if address is None:
                address = _create(api, drive_id, file)
                if not file["size"]:
                    return
            elif unsure and offset == file["size"]:
                return  # whole, and verified when its offset was asked for
            unsure = True
            offset = _send_chunk(api, address, file, source, offset, sending)
            if offset == file["size"]:
                return
            unsure, failures = False, 0
        except ServiceError as error:
            if isinstance(error, AnswerError):
                if error.status == 409 and error.code == "conflict":
                    return  # complete already, by another client
                if error.code == "file-mismatch":
                    _check_unchanged(source, file)
                if error.status not in RETRIED_STATUS and (address is None or error.status not in GOES_ON):
                    raise
            failures = 1 if offset > at else failures + 1
            if failures > RETRIES.tries:
                raise
            if failures > 1:
                sending.over.wait(RETRIES.pause_s(failures - 1))


def _send_chunk(api: Api, address: str, file: dict[str, Any], source: Path, offset: int, sending: _Sending) -> int:
    """The offset after one more chunk."""
    chunk = Chunk(source, offset, min(sending.chunk.now, file["size"] - offset), file["size"])
    headers = {**TUS, **CONTENT, "Upload-Offset": str(offset), **chunk.headers()}
    started = time.monotonic()
    try:
        response = api.once("PATCH", address, headers=headers, content=chunk.blocks())
    except ServiceError:
        sending.chunk.broke()
        raise
    sending.chunk.arrived(time.monotonic() - started)
    reached = int(response.headers["Upload-Offset"])
    sending.counter.add(reached - offset)
    return reached


def _create(api: Api, drive_id: str, file: dict[str, Any]) -> str:
    """The address of a new upload, without a byte: of one whose answer is lost nothing is lost."""
    named = f"drive {_base64(drive_id.encode())},path {_base64(file['path'].encode())}"
    headers = {**TUS, "Upload-Length": str(file["size"]), "Upload-Metadata": named}
    return str(api.once("POST", "/v1/uploads", headers=headers).headers["Location"])


def _continue_at(api: Api, address: str | None, offset: int) -> tuple[str | None, int]:
    """The address and where its stored bytes end; (None, 0) where the server knows it no more. Raises ServiceError."""
    if address is None:
        return None, 0
    try:
        return address, int(api.once("HEAD", address, headers=TUS).headers["Upload-Offset"])
    except AnswerError as error:
        if error.status in (404, 410):
            return None, 0
        raise


def _check_unchanged(source: Path, file: dict[str, Any]) -> None:
    """Raise LogError where the file is not what was announced any more: it would be sent and refused for ever."""
    if hash_file(source) != (file["size"], file["sha256"]):
        raise LogError("has changed since it was announced", file=source, remedy="run the command again")


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()
