"""Manifest of a drive as it comes over HTTP: parsed file by file, so that one of 200,000 files holds up nobody else.

One call of a JSON parser or a validator over all of it would hold Python's global lock for seconds, in whatever thread it runs.
"""

import json
import re
from collections.abc import Iterator
from typing import Any, Final

from pydantic import ValidationError

from wayloom.errors import InputError
from wayloom.store.manifest import Manifest, ManifestFile, PathError

_SPACE: Final = re.compile(r"[ \t\n\r]*")
_DECODER: Final = json.JSONDecoder()
SHOWN: Final = 20
LONGEST_ENTRY: Final = 64 << 10
"""Characters of one entry; a manifest's are a few hundred. A deeper or longer one would be parsed in one go."""


class TooManyFilesError(InputError):
    """The manifest names more files than are allowed."""

    code = "too-large"


class ManifestTextError(InputError):
    """The text is no manifest. `found` lists where (a path of keys), what, and a stable code of each fault."""

    code = "malformed-request"

    def __init__(self, found: list[dict[str, str]]) -> None:
        super().__init__(f"{found[0]['where']}: {found[0]['what']}")
        self.found = found


def parse_manifest(content: bytes, most_files: int) -> Manifest:
    """The manifest. Raises ManifestTextError, TooManyFilesError."""
    try:
        text = content.decode()
        head, files = _parts(text, most_files)
    except (ValueError, RecursionError) as error:
        raise ManifestTextError([_fault("body", str(error)[:200], "bad-json")]) from None
    try:
        return Manifest.model_validate({**head, "files": files} if files is not None else head)
    except ValidationError as error:
        raise ManifestTextError(_faults("body", error)) from None


def _parts(text: str, most_files: int) -> tuple[dict[str, Any], tuple[ManifestFile, ...] | None]:
    """What stands beside the files, and the files. Raises ValueError where it is no JSON object."""
    head: dict[str, Any] = {}
    files: tuple[ManifestFile, ...] | None = None
    at = _expect(text, 0, "{")
    if text[at : at + 1] == "}":
        return head, None
    while True:
        key, at = _value(text, at)
        if not isinstance(key, str):
            raise ValueError("a key of a JSON object is a string")
        at = _expect(text, at, ":")
        if key == "files" and text[at : at + 1] == "[":
            entries = _Entries(text, at)
            files = tuple(_files(entries, most_files))
            at = entries.at
        else:
            head[key], at = _value(text, at)
        if text[at : at + 1] == "}":
            if _skip(text, at + 1) != len(text):
                raise ValueError("something follows the JSON object")
            return head, files
        at = _expect(text, at, ",")


class _Entries:
    """The elements of the JSON array that begins at `at`, which ends behind it."""

    def __init__(self, text: str, at: int) -> None:
        self._text, self.at = text, at

    def __iter__(self) -> Iterator[Any]:
        self.at = _expect(self._text, self.at, "[")
        if self._text[self.at : self.at + 1] != "]":
            while True:
                entry, self.at = _value(self._text, self.at)
                yield entry
                if self._text[self.at : self.at + 1] == "]":
                    break
                self.at = _expect(self._text, self.at, ",")
        self.at = _skip(self._text, self.at + 1)


def _files(entries: _Entries, most: int) -> Iterator[ManifestFile]:
    for number, entry in enumerate(entries):
        if number >= most:
            raise TooManyFilesError(f"the drive has more than the {most} files that are allowed")
        try:
            yield ManifestFile.model_validate(entry)
        except ValidationError as error:
            raise ManifestTextError(_faults(f"body.files.{number}", error)) from None


def _value(text: str, at: int) -> tuple[Any, int]:
    """The JSON value at `at`, and where the next sign is."""
    try:
        value, end = _DECODER.raw_decode(text, at)
    except json.JSONDecodeError as error:
        raise ValueError(f"no JSON at character {error.pos}: {error.msg}") from None
    if end - at > LONGEST_ENTRY:
        raise ValueError(f"the value at character {at} has {end - at} characters, {LONGEST_ENTRY} are allowed")
    return value, _skip(text, end)


def _expect(text: str, at: int, sign: str) -> int:
    """Where the sign after this one is."""
    at = _skip(text, at)
    if text[at : at + 1] != sign:
        raise ValueError(f"no JSON at character {at}: {sign!r} is missing")
    return _skip(text, at + 1)


def _skip(text: str, at: int) -> int:
    found = _SPACE.match(text, at)
    return at if found is None else found.end()


def _faults(where: str, error: ValidationError) -> list[dict[str, str]]:
    found = []
    for one in error.errors(include_input=False, include_url=False)[:SHOWN]:
        cause = one.get("ctx", {}).get("error")
        code = cause.code if isinstance(cause, PathError) else one["type"].replace("_", "-")
        found.append(_fault(".".join([where, *(str(part) for part in one["loc"])]), str(one["msg"]), code))
    return found


def _fault(where: str, what: str, code: str) -> dict[str, str]:
    return {"where": where, "what": what.encode("utf-8", "replace").decode(), "code": code}
