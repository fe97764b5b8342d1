"""Content-addressed blob store: immutable bytes by their own hash, in a local folder or any object store that obstore speaks."""

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

import obstore
from obstore.exceptions import BaseError
from obstore.store import LocalStore, from_url

from wayloom.errors import NotFoundError

if TYPE_CHECKING:  # names of its stubs only
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

BlobError = BaseError
"""Whatever goes wrong between wayloom and its object store."""
CONNECT: Final = "5s"
ANSWER: Final = "60s"
RETRIES: Final["RetryConfig"] = {"max_retries": 2, "retry_timeout": timedelta(seconds=20)}
"""Short, so that whoever asks hears that it is away: a job waits and is tried again, a client is told to."""
DIGEST = re.compile("[0-9a-f]{64}")


def open_store(url: str) -> "ObjectStore":
    """The object store of a URL; its address and its keys come from the variables of its own tools, `AWS_ENDPOINT` and so on.
    Raises BlobError, ValueError where the URL cannot be used."""
    plain = os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("1", "true")  # options that are given at all hide the variable
    options: ClientConfig = {"connect_timeout": CONNECT, "timeout": ANSWER, "allow_http": plain}
    return from_url(url, client_options=options, retry_config=RETRIES)


class BlobStore:
    """Content-addressed, put once, never overwritten."""

    def __init__(self, folder: Path, url: str | None = None) -> None:
        if url is None:
            folder.mkdir(parents=True, exist_ok=True)
        self._store = LocalStore(folder) if url is None else open_store(url)

    def put(self, content: bytes) -> str:
        """Store the bytes and return their SHA-256 in hexadecimal. Storing them again changes nothing."""
        digest = hashlib.sha256(content).hexdigest()
        if not self.has(digest):  # not a conditional put: few object stores have it, and equal names are equal bytes
            obstore.put(self._store, _name(digest), content)
        return digest

    def get(self, digest: str) -> bytes:
        """The bytes. Raises NotFoundError."""
        try:
            return bytes(obstore.get(self._store, _name(digest)).bytes())
        except FileNotFoundError:
            raise NotFoundError(f"blob {digest} is not in the store") from None

    def has(self, digest: str) -> bool:
        """Whether the bytes are there."""
        try:
            obstore.head(self._store, _name(digest))
        except FileNotFoundError:
            return False
        return True

    def older_than(self, seconds: float) -> Iterator[str]:
        """The digests of the blobs that were stored so long ago; what else may lie in the store is passed over."""
        before = datetime.now(UTC) - timedelta(seconds=seconds)
        for found in obstore.list(self._store):
            for entry in found:
                digest = entry["path"].rpartition("/")[2]
                if DIGEST.fullmatch(digest) and entry["path"] == _name(digest) and entry["last_modified"] <= before:
                    yield digest

    def delete(self, digest: str) -> None:
        """Forget the bytes. Deleting what is not there is no error."""
        with contextlib.suppress(FileNotFoundError):
            obstore.delete(self._store, _name(digest))


class NotedBlobs(BlobStore):
    """A blob store that notes what is put there, `digests`."""

    def __init__(self, blobs: BlobStore) -> None:
        self._store = blobs._store
        self.digests: set[str] = set()

    def put(self, content: bytes) -> str:
        digest = super().put(content)
        self.digests.add(digest)
        return digest


def _name(digest: str) -> str:
    return f"{digest[:2]}/{digest}"
