"""The service that is tried: requests as a client writes them by hand, and a drive that never becomes whole."""

import base64
import hashlib
import os
import secrets
from typing import Any, Final, Self

import httpx2

from wayloom.client.api import check_address
from wayloom.errors import ServiceError

VERSION: Final = "1.0.0"
CONTENT_TYPE: Final = "application/offset+octet-stream"
UPLOADS: Final = "/v1/uploads"
FILES: Final = 40
FILE_BYTES: Final = 300_000
"""More than one piece of a verified chunk, and more than a socket holds."""
TIMEOUT_S: Final = 30.0


class FailedCheckError(Exception):
    """What was expected of the service and is not so."""


def expect(holds: bool, otherwise: str) -> None:
    """Raises FailedCheckError where it does not hold."""
    if not holds:
        raise FailedCheckError(otherwise)


class Subject:
    """One service with a drive of some files that are random bytes. Its last file is never sent, so that no stage ever begins.

    Raises ConfigError for what is no address, ServiceError where the service does not answer or does not take the drive.
    """

    def __init__(self, url: str, key: str | None = None) -> None:
        check_address(url)
        key = key or os.environ.get("WAYLOOM_API_KEY")
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        self.url, self.headers = url.rstrip("/"), headers
        self.http = httpx2.Client(base_url=self.url, headers=headers, timeout=TIMEOUT_S, trust_env=False)
        seed = secrets.token_bytes(16)
        self._contents = {f"log/{number:03d}.bin": _bytes_of(seed, number) for number in range(FILES)}
        self._unused = list(self._contents)[:-1]
        self.manifest = {
            "name": f"selftest-{seed.hex()[:8]}",
            "files": [
                {"path": path, "size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
                for path, content in self._contents.items()
            ],
        }
        self.drive_id = self._registered()["id"]
        answer = self.send("OPTIONS", UPLOADS)
        self.extensions = {name.strip() for name in answer.headers.get("tus-extension", "").split(",")}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.http.close()

    def _registered(self) -> dict[str, Any]:
        answer = self.send("POST", "/v1/drives", json=self.manifest)
        if answer.status_code not in (200, 201):
            raise ServiceError(f"{self.url} does not take a drive: it answers {answer.status_code} (is a key needed?)")
        found: dict[str, Any] = answer.json()
        return found

    def is_missing(self, path: str) -> bool:
        """Whether the service still asks for the file."""
        return path in {file["path"] for file in self._registered()["missing"]}

    def new_file(self) -> tuple[str, bytes]:
        """A file of the drive that no check has used, and its bytes."""
        path = self._unused.pop(0)
        return path, self._contents[path]

    def send(self, method: str, path: str, headers: dict[str, str] | None = None, **more: Any) -> httpx2.Response:
        """A request as it is written. Raises ServiceError when no answer comes."""
        try:
            return self.http.request(method, path, headers=headers, **more)
        except httpx2.HTTPError as error:
            raise ServiceError(f"{self.url} does not answer: {str(error) or type(error).__name__}") from error

    def create(self, path: str, length: int, content: bytes | None = None, **more: str) -> httpx2.Response:
        """Begin an upload, with the first bytes where there are some."""
        headers = {"Tus-Resumable": VERSION, "Upload-Length": str(length), "Upload-Metadata": self.metadata(path), **more}
        headers |= {} if content is None else {"Content-Type": CONTENT_TYPE}
        return self.send("POST", UPLOADS, headers, content=content)

    def begun(self, path: str, length: int) -> str:
        """The address of a new upload."""
        answer = self.create(path, length)
        expect(answer.status_code == 201, f"POST answered {answer.status_code}, not 201")
        expect("location" in answer.headers, "POST gave no Location")
        return str(answer.headers["location"])

    def metadata(self, path: str) -> str:
        """Upload-Metadata of a file."""
        return f"drive {_base64(self.drive_id.encode())},path {_base64(path.encode())}"

    def head(self, address: str) -> httpx2.Response:
        """Ask how far an upload is."""
        return self.send("HEAD", address, {"Tus-Resumable": VERSION})

    def offset(self, address: str) -> int:
        """How far an upload is."""
        answer = self.head(address)
        text = answer.headers.get("upload-offset", "")
        expect(answer.status_code in (200, 204) and text.isdigit(), f"HEAD answered {answer.status_code}, Upload-Offset {text!r}")
        return int(text)

    def patch(self, address: str, offset: int, content: bytes, **more: str) -> httpx2.Response:
        """Continue an upload."""
        headers = {"Tus-Resumable": VERSION, "Content-Type": CONTENT_TYPE, "Upload-Offset": str(offset), **more}
        return self.send("PATCH", address, headers, content=content)

    def remove(self) -> bool:
        """Have the drive removed again. Whether the service does so."""
        return self.send("DELETE", f"/v1/drives/{self.drive_id}").is_success


def checksum(content: bytes, algorithm: str = "sha1") -> str:
    """Upload-Checksum of a chunk."""
    return f"{algorithm} {_base64(hashlib.new(algorithm, content).digest())}"


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _bytes_of(seed: bytes, number: int) -> bytes:
    return hashlib.shake_256(seed + number.to_bytes(2, "big")).digest(FILE_BYTES)
