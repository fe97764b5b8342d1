"""The manifest: what names a drive, and which paths are refused."""

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from wayloom.store.manifest import USUAL, Manifest, ManifestFile, check_parts, check_path

DIGEST = hashlib.sha256(b"").hexdigest()


def manifest(*paths: str, **more: object) -> Manifest:
    return Manifest(name="a drive", files=tuple(ManifestFile(path=path, size=3, sha256=DIGEST) for path in paths), **more)


def test_the_id_is_the_hash_of_the_canonical_json() -> None:
    expected = f'{{"files":[{{"path":"log/a","sha256":"{DIGEST}","size":3}}],"log":"log","name":"a drive"}}'
    assert manifest("log/a").canonical() == expected.encode()
    assert manifest("log/a").drive_id == hashlib.sha256(expected.encode()).hexdigest()


def test_the_order_of_the_files_does_not_change_the_id() -> None:
    assert manifest("log/a", "log/b").drive_id == manifest("log/b", "log/a").drive_id


def test_another_byte_is_another_drive() -> None:
    other = Manifest(name="a drive", files=(ManifestFile(path="log/a", size=3, sha256="0" * 64),))
    assert manifest("log/a").drive_id != other.drive_id


@pytest.mark.parametrize(
    "path",
    [
        "", "a", "log", "log/", "/log/a", "log//a", "log/../a", "log/./a", "../log/a", "log/a\0", "log/a\nb", "log/\u202ea",
        "log\\a", "log/c:a", "log/a ", "log/ a", "log/a.", "etc/passwd", "log/" + "x" * 300, "log/\ud800",
    ],
)  # fmt: skip
def test_a_path_that_could_leave_its_folder_or_confuse_is_refused(path: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - the message is for people
        check_path(path)


@pytest.mark.parametrize(
    "path", ["log/a", "log/image_0/000001.png", "gnss/2011_sync/oxts/data/0.txt", "log/größe/ф.png", "log/.hidden"]
)
def test_an_ordinary_path_is_taken(path: str) -> None:
    assert check_path(path) == path


@given(st.text(max_size=40))
def test_no_path_that_is_taken_leaves_its_folder(path: str) -> None:
    try:
        check_path(path)
    except ValueError:
        return
    assert path.split("/")[0] in ("log", "gnss")
    assert ".." not in path.split("/")
    assert "\0" not in path


@given(st.from_regex(USUAL, fullmatch=True))
def test_the_short_way_for_usual_paths_takes_none_that_the_parts_refuse(path: str) -> None:
    assert check_parts(path) == path


@pytest.mark.parametrize(
    "paths", [("log/a", "log/a"), ("log/A", "log/a"), ("log/ﬁ", "log/fi"), ("log/a", "log/a/b"), ("log/a/b", "log/A")]
)
def test_files_that_are_one_on_some_file_systems_are_refused(paths: tuple[str, ...]) -> None:
    with pytest.raises(ValidationError):
        manifest(*paths)


@pytest.mark.parametrize(
    "more", [{"log": "log/other"}, {"log": "gnss"}, {"gnss": "gnss/x"}, {"gnss": "log"}, {"owner": "me"}, {"name": "a\nb"}]
)
def test_a_manifest_that_contradicts_itself_is_refused(more: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        Manifest(**{"name": "a", "files": (ManifestFile(path="log/a", size=1, sha256=DIGEST),), **more})  # type: ignore[arg-type]
