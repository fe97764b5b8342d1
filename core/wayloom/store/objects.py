"""Named objects of an object store: what drives have sent, where it lies in one."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import Final

import obstore

from wayloom.errors import ConfigError, NotFoundError
from wayloom.store.blobs import BlobError, open_store

DELETED_AT_ONCE: Final = 1000
"""Names of one request: more S3 does not take."""


class Objects:
    """The objects below a URL, `s3://bucket/prefix`. Every method is blocking, and raises `wayloom.store.blobs.BlobError` where
    the store does not answer. A URL that cannot be used raises ConfigError."""

    def __init__(self, url: str) -> None:
        try:
            self._store = open_store(url)
        except (BlobError, ValueError) as error:
            raise ConfigError(f"uploads.url: {error}", remedy="write s3://bucket/prefix, gs://, az:// or file:///folder") from error

    def put(self, name: str, content: bytes | bytearray) -> None:
        """Store the bytes, in one request."""
        obstore.put(self._store, name, content, use_multipart=False)

    def get(self, name: str, length: int) -> bytes:
        """The first `length` bytes of an object. Raises NotFoundError."""
        try:
            return bytes(obstore.get_range(self._store, name, start=0, length=length)) if length else b""
        except FileNotFoundError:
            raise NotFoundError(f"object {name} is not in the store") from None

    def get_all(self, name: str) -> bytes:
        """An object. Raises NotFoundError."""
        try:
            return bytes(obstore.get(self._store, name).bytes())
        except FileNotFoundError:
            raise NotFoundError(f"object {name} is not in the store") from None

    def has(self, name: str) -> bool:
        """Whether there is such an object."""
        try:
            obstore.head(self._store, name)
        except FileNotFoundError:
            return False
        return True

    def delete(self, names: Sequence[str]) -> None:
        """Forget objects. Deleting what is not there is no error."""
        for start in range(0, len(names), DELETED_AT_ONCE):
            obstore.delete(self._store, list(names[start : start + DELETED_AT_ONCE]))

    def older_than(self, seconds: float, below: str) -> Iterator[list[str]]:
        """The names of the objects below a prefix that were stored so long ago, some at a time."""
        before = datetime.now(UTC) - timedelta(seconds=seconds)
        for found in obstore.list(self._store, below):
            yield [entry["path"] for entry in found if entry["last_modified"] <= before]
