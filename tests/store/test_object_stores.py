"""Blobs in a real object store, spoken to without TLS, as behind the wall of a deployment's own network."""

import os
from pathlib import Path

import pytest

from service_kit.object_store import ObjectStoreServer
from wayloom.errors import ConfigError, NotFoundError
from wayloom.store.blobs import BlobError, BlobStore
from wayloom.store.objects import Objects


def test_blobs_are_put_listed_and_deleted_in_an_object_store(
    tmp_path: Path, object_store: ObjectStoreServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in object_store.variables.items():
        monkeypatch.setenv(name, value)
    blobs = BlobStore(tmp_path, object_store.new_url())
    digest = blobs.put(b"content")
    assert (blobs.get(digest), [*blobs.older_than(0.0)]) == (b"content", [digest])
    blobs.delete(digest)
    assert not blobs.has(digest)
    with pytest.raises(NotFoundError):
        blobs.get(digest)
    assert not os.listdir(tmp_path)


def test_an_object_store_without_tls_is_refused_where_nobody_has_allowed_it(
    tmp_path: Path, object_store: ObjectStoreServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in object_store.variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    with pytest.raises(BlobError):
        BlobStore(tmp_path, object_store.new_url()).put(b"content")


def test_a_url_that_is_none_of_an_object_store_is_said() -> None:
    with pytest.raises(ConfigError, match=r"uploads\.url"):
        Objects("ftp://host/folder")
