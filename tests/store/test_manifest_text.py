"""The manifest as text: the same as by pydantic at once, every fault with its place and a stable code."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayloom.store.manifest import Manifest
from wayloom.store.manifest_text import ManifestTextError, TooManyFilesError, parse_manifest

DIGEST = "0" * 64


def text_of(*paths: object, **more: object) -> bytes:
    files = [{"path": path, "size": 3, "sha256": DIGEST} for path in paths]
    return json.dumps({"name": "a drive", "files": files, **more}).encode()


def code_of(content: bytes) -> str:
    with pytest.raises(ManifestTextError) as caught:
        parse_manifest(content, 10)
    return caught.value.found[0]["code"]


NAMES = st.text(st.characters(codec="utf-8", categories=("L", "N")), min_size=1, max_size=9)


@given(st.lists(NAMES, min_size=1, unique_by=str.casefold))
def test_a_manifest_is_read_as_it_is_by_a_parser_that_takes_it_at_once(names: list[str]) -> None:
    content = text_of(*(f"log/{name}" for name in names), vehicle_id="car 7")
    try:
        expected = Manifest.model_validate_json(content)
    except ValueError:
        return  # two names that are one in NFKC
    found = parse_manifest(content, 1000)
    assert found == expected
    assert found.drive_id == expected.drive_id


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("log/../a", "unsafe-path"), ("/etc/passwd", "unsafe-path"), ("log/a\0", "unsafe-path"), ("log/\u202ea", "unsafe-path"),
        ("log\\a", "unsafe-path"), ("other/a", "unsafe-path"), ("log/" + "x" * 256, "path-too-long"),
        ("log/" + "ä" * 200, "path-too-long"), ("log/" + "a/" * 600 + "a", "string-too-long"), (7, "string-type"),
        (None, "string-type"),
    ],
)  # fmt: skip
def test_a_path_that_cannot_be_is_refused_with_a_stable_code(path: object, code: str) -> None:
    assert code_of(text_of(path)) == code


@pytest.mark.parametrize(
    ("one", "other"), [("log/a", "log/A"), ("log/a", "log/a"), ("log/\u00e9", "log/e\u0301"), ("log/a", "log/A/b")]
)
def test_two_paths_that_one_disk_takes_for_one_are_refused(one: str, other: str) -> None:
    assert code_of(text_of(one, other)) == "duplicate-path"


@pytest.mark.parametrize("size", [True, "3", 3.5, None, [3], -1, 2**53, 1e400])
def test_a_size_that_is_no_whole_number_of_bytes_is_refused(size: object) -> None:
    content = json.dumps({"name": "a", "files": [{"path": "log/a", "size": size, "sha256": DIGEST}]}).encode()
    with pytest.raises(ManifestTextError) as caught:
        parse_manifest(content, 10)
    assert caught.value.found[0]["where"] == "body.files.0.size"


@pytest.mark.parametrize(
    "content",
    [
        b"", b"{", b"[]", b"null", b"{}x", b'{"files":[', b'{"files":[1', b'{"files":[{},', b'{"files":{}}', b'{"files":[]}',
        b"\xff", b'{1:2}', b'{"name":"a" "files":[]}', b'{"name":' + b"[" * 100_000, b'{"files":[' + b'{"a":' * 100_000,
        text_of("log/a") + b"{}", b'{"name":"' + b"x" * 100_000 + b'"}',
    ],
)  # fmt: skip
def test_text_that_is_no_manifest_is_refused_without_a_traceback(content: bytes) -> None:
    assert code_of(content)


def test_more_files_than_allowed_are_refused_before_the_rest_is_read() -> None:
    with pytest.raises(TooManyFilesError, match="more than the 10 files"):
        parse_manifest(text_of(*(f"log/{i}" for i in range(12)))[:-30] + b"no JSON", 10)
