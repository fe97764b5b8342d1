"""Resumable, parallel upload of one drive (tus protocol), continued where the server's stored bytes end.

Files are sent one by one, small ones in packs where the server takes them (`wayloom.client.streams`).
"""

import threading
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any, Final

from wayloom.client.api import AnswerError, Api
from wayloom.client.chunks import FIRST, LARGEST, ChunkSize
from wayloom.client.counting import Counter
from wayloom.client.manifests import PackedDrive
from wayloom.client.rates import UNLIMITED, RateLimit
from wayloom.client.streams import TUS, OneFile, PackOfFiles, Stream
from wayloom.config.backoff import Backoff
from wayloom.config.progress import Progress, silent
from wayloom.errors import ServiceError
from wayloom.store.packs import LARGEST_PACKED

CONNECTIONS: Final = 4
CONTENT: Final = {"Content-Type": "application/offset+octet-stream"}
RETRIES: Final = Backoff(first_s=0.125, longest_s=16.0, tries=10)
"""Of one file, after failures that brought no byte."""
GOES_ON: Final = frozenset({404, 408, 409, 410, 460})
"""Answers after which the server is asked how far the upload is."""
LOST: Final = frozenset({404, 410})
"""Answers of a server that does not know an upload any more."""
ROUNDS: Final = 3
"""How often the server is asked what it lacks: a file that was damaged on the way is sent again."""
LARGEST_PACK: Final = 10_000
"""Files of one pack, which is what servers take."""
LEAST_PACK: Final = 500
"""Fewer files are not parted into two packs, of which one is received while the other one is made durable."""


class UploadStopped(Exception):  # noqa: N818 - no error: another file's upload has failed and this one ends
    """The upload is over for another reason."""


def upload(
    api: Api,
    packed_drive: PackedDrive,
    progress: Progress = silent,
    connections: int = CONNECTIONS,
    chunk: int = LARGEST,
    limit: RateLimit = UNLIMITED,
    packs: bool = True,
    again: bool = False,
) -> dict[str, Any]:
    """Send what the server lacks of the drive and return its registration.

    Running it again after any interruption continues; running it for a drive that is complete sends nothing.
    chunk : most bytes of one request
    packs : whether small files are sent in packs where the server takes them
    again : send also what the server had and has deleted
    Raises LogError when a file changed on the way, ServiceError when the server stays away or refuses.
    """
    manifest = packed_drive.manifest.model_dump(mode="json", exclude_none=True)
    total, files = packed_drive.manifest.byte_count, len(packed_drive.manifest.files)
    counter = Counter(total, files, progress)
    address = "/v1/drives?again=true" if again else "/v1/drives"
    for _ in range(ROUNDS):
        registration: dict[str, Any] = api.json("POST", address, json=manifest)
        missing = registration["missing"]
        counter.set(total - sum(file["size"] - file["offset"] for file in missing), files - len(missing))
        if not missing:
            return registration
        streams = _streams(api, packed_drive, registration, packs)
        _send_all(api, streams, _Sending(counter, ChunkSize(min(FIRST, chunk), largest=chunk), limit), connections)
    registration = api.json("POST", "/v1/drives", json=manifest)
    if registration["missing"]:
        raise ServiceError(
            f"{len(registration['missing'])} files did not arrive whole, the first is {registration['missing'][0]['path']}"
        )
    counter.set(total, files)
    return registration


@dataclass(frozen=True, slots=True)
class _Begun:
    """A stream, and where it is continued: its address on the server, if it has one, and how much of it is counted already."""

    stream: Stream
    address: str | None = None
    offset: int = 0


def _streams(api: Api, packed_drive: PackedDrive, registration: dict[str, Any], packs: bool) -> list[_Begun]:
    """What is missing, in the streams that it is sent in: packs that were begun first."""
    drive_id, sources = registration["id"], packed_drive.sources
    missing = {file["path"]: file for file in registration["missing"]}
    found = []
    for pack in registration.get("packs") or ():
        files = _files_of(api, pack["upload"])
        if any(file["path"] in missing for file in files):
            here = sum(file["size"] for file in files if missing.pop(file["path"], None) is None)
            found.append(_Begun(PackOfFiles(drive_id, files, sources), pack["upload"], here))
    may_pack = "packs" in registration and packs
    small = [file for file in missing.values() if may_pack and file["size"] <= LARGEST_PACKED and file["upload"] is None]
    if len(small) > 1:
        each = min(LARGEST_PACK, max(LEAST_PACK, -(-len(small) // 2)))
        found += [_Begun(PackOfFiles(drive_id, small[start : start + each], sources)) for start in range(0, len(small), each)]
        packed = {file["path"] for file in small}
        missing = {path: file for path, file in missing.items() if path not in packed}
    alone = [_Begun(OneFile(drive_id, file, sources[path]), file["upload"], int(file["offset"])) for path, file in missing.items()]
    return found + alone


def _files_of(api: Api, pack: str) -> list[dict[str, Any]]:
    """The files of a pack that was begun, none where the server has lost it: they go without it then. Raises ServiceError."""
    try:
        files: list[dict[str, Any]] = api.json("GET", f"{pack}/files")["files"]
    except AnswerError as error:
        if error.status in LOST:
            return []
        raise
    return files


@dataclass(frozen=True, slots=True)
class _Sending:
    """What the streams of one upload share: the counter, the link's chunk size, its limit, and whether it is over."""

    counter: Counter
    chunk: ChunkSize
    limit: RateLimit
    over: threading.Event = field(default_factory=threading.Event)

    def check(self) -> None:
        """Raise UploadStopped when another stream has failed."""
        if self.over.is_set():
            raise UploadStopped


def _send_all(api: Api, streams: Sequence[_Begun], sending: _Sending, connections: int) -> None:
    with ThreadPoolExecutor(connections) as pool:
        futures = [pool.submit(_send, api, begun, sending) for begun in streams]
        try:
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            sending.over.set()
            pool.shutdown(cancel_futures=True)
    for future in done:
        error = future.exception()
        if error is not None and not isinstance(error, UploadStopped):
            raise error


def _send(api: Api, begun: _Begun, sending: _Sending) -> None:
    """One stream from where the server has it, and on from there after every interruption. Only those that bring nothing count."""
    stream, address, offset = begun.stream, begun.address, begun.offset
    failures, unsure, doubted = 0, address is not None, False
    while True:
        sending.check()
        at = offset
        try:
            if unsure:
                address, offset = _continue_at(api, address, at)
                sending.counter.add(offset - at, stream.files_before(offset) - stream.files_before(at))
                if doubted:
                    stream.check_unchanged(offset)
                    doubted = False
            if address is None:
                count, files = stream.length, stream.files_before(stream.length)
                address = stream.create(api)
                sending.counter.add(count - stream.length, files - stream.files_before(stream.length))
                if address is None:
                    return
            elif unsure and offset == stream.length:
                return  # whole, and verified when its offset was asked for
            unsure = True
            offset = _send_chunk(api, address, stream, offset, sending)
            if offset == stream.length:
                return
            unsure, failures = False, 0
        except ServiceError as error:
            if isinstance(error, AnswerError):
                if error.status == 409 and error.code == "conflict":
                    return  # complete already, by another client
                doubted = doubted or error.code == "file-mismatch"
                if not error.is_passing and (address is None or error.status not in GOES_ON):
                    raise
            failures = 1 if offset > at else failures + 1
            if failures > RETRIES.tries:
                raise
            if failures > 1:
                sending.over.wait(RETRIES.pause_s(failures - 1))


def _send_chunk(api: Api, address: str, stream: Stream, offset: int, sending: _Sending) -> int:
    """The offset after one more chunk."""
    chunk = stream.chunk(offset, sending.chunk.now)
    headers = {**TUS, **CONTENT, "Upload-Offset": str(offset), **chunk.headers()}
    started = time.monotonic()
    try:
        response = api.once("PATCH", address, headers=headers, content=sending.limit.over(chunk.blocks()))
    except ServiceError:
        sending.chunk.broke()
        raise
    sending.chunk.arrived(time.monotonic() - started)
    reached = int(response.headers["Upload-Offset"])
    sending.counter.add(reached - offset, stream.files_before(reached) - stream.files_before(offset))
    return reached


def _continue_at(api: Api, address: str | None, offset: int) -> tuple[str | None, int]:
    """The address and where its stored bytes end; (None, 0) where the server knows it no more. Raises ServiceError."""
    if address is None:
        return None, 0
    try:
        return address, int(api.once("HEAD", address, headers=TUS).headers["Upload-Offset"])
    except AnswerError as error:
        if error.status in LOST:
            return None, 0
        raise
