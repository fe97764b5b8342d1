"""Text file parsing with errors that name file, line and remedy."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError, LogError
from wayloom.files.regular import MOST_BYTES, IrregularFileError, LargeFileError, open_regular, read_regular

FloatArray = NDArray[np.float64]
QUOTE_CHARACTERS = 40
MOST_WORDS = 1000
"""Of a line of too many words, so many are looked through for one that is no number."""
LONGEST_LINE, MOST_LINES = 1 << 16, 20_000_000
"""Of a table that is read line by line: five hours of 1 kHz samples, or 23 days of frames."""
MOST_TEXT = 64 << 20
"""Bytes of a text that is read as a whole."""
LARGEST_NUMBER = 1e12


def quoted(text: str) -> str:
    """Text from a file as it may stand in a message: on one line, quoted, not longer than QUOTE_CHARACTERS."""
    shown = text if len(text) <= QUOTE_CHARACTERS else text[:QUOTE_CHARACTERS] + "…"
    return repr(shown)


def utf8_text(of_path: str) -> str:
    """A path's text as UTF-8 can hold it: bytes that are none (names from other systems) become replacement characters."""
    return of_path.encode(errors="surrogateescape").decode(errors="replace")


def read_bytes(file: Path, *, remedy: str, error: type[InputError] = LogError, most: int = MOST_BYTES) -> bytes:
    """The bytes of a file. Raises `error`, with the remedy, where it is missing, and says why where it cannot be read."""
    try:
        return read_regular(file, most)
    except FileNotFoundError:
        raise error("no such file", file=file, remedy=remedy, reason="file.missing") from None
    except OSError as problem:
        what, remedy = f"cannot be read ({problem.strerror})", "check the file and its permissions"
        raise error(what, file=file, remedy=remedy, reason=reason_of(problem)) from None


def reason_of(problem: OSError) -> str:
    """The code of `REASONS` for a file that could not be read."""
    if isinstance(problem, FileNotFoundError):
        return "file.missing"
    if isinstance(problem, IrregularFileError):
        return "file.irregular"
    return "file.too_large" if isinstance(problem, LargeFileError) else "file.unreadable"


def read_text(file: Path, *, remedy: str, error: type[InputError] = LogError) -> str:
    """The UTF-8 text of a file. Raises `error` where it is missing, unreadable or no text."""
    data = read_bytes(file, remedy=remedy, error=error, most=MOST_TEXT)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        what = f"byte {problem.start} is not UTF-8 text"
        raise error(what, file=file, remedy="the file is damaged: copy it again from the vehicle", reason="file.not_text") from None


def stream_lines(file: Path, *, remedy: str) -> Iterator[str]:
    """The lines of a text file as of `read_lines`, one in memory at a time, for tables that may be long.

    Raises LogError where it is missing, unreadable or no text; for a line of more than LONGEST_LINE bytes or more than MOST_LINES.
    """
    blank = 0
    try:
        with open_regular(file) as stream:
            for number in itertools.count(1):
                data = stream.readline(LONGEST_LINE + 1)
                if not data:
                    return
                if len(data) > LONGEST_LINE or number > MOST_LINES:
                    what = f"has more than {MOST_LINES} lines" if number > MOST_LINES else f"has more than {LONGEST_LINE} bytes"
                    raise LogError(what, file=file, record=f"line {number}", remedy=remedy, reason="file.too_large")
                line = _decoded_line(data, file, number)
                if not line:
                    blank += 1  # those at the file's end are not told
                    continue
                yield from itertools.repeat("", blank)
                blank = 0
                yield line
    except OSError as problem:
        if isinstance(problem, FileNotFoundError):
            raise LogError("no such file", file=file, remedy=remedy, reason="file.missing") from None
        what, remedy = f"cannot be read ({problem.strerror})", "check the file and its permissions"
        raise LogError(what, file=file, remedy=remedy, reason=reason_of(problem)) from None


def _decoded_line(data: bytes, file: Path, number: int) -> str:
    try:
        return data.decode("utf-8-sig" if number == 1 else "utf-8").strip()
    except UnicodeDecodeError as problem:
        what, remedy = f"byte {problem.start} of the line is not UTF-8 text", "the file is damaged: copy it again from the vehicle"
        raise LogError(what, file=file, record=f"line {number}", remedy=remedy, reason="file.not_text") from None


def read_lines(file: Path, *, remedy: str) -> list[str]:
    """The lines of a text file, without blank lines at its end (a blank one between others stays, so that numbers count lines)."""
    lines = read_text(file, remedy=remedy).split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    return [line.strip() for line in lines]


def parse_numbers(
    text: str, *, file: Path, record: str, count: int | None = None, error: type[InputError] = LogError
) -> FloatArray:
    """Whitespace-separated finite numbers, `count` of them where given, (count,). Raises `error` naming the first that is none."""
    words = text.split()
    if count is not None and len(words) != count:
        what = f"{len(words)} numbers where {count} belong"
        if (stray := next((word for word in words[:MOST_WORDS] if not _is_number(word)), None)) is not None:
            what += f", and {quoted(stray)} is not a number"
        raise error(what, file=file, record=record, remedy="the line is cut or damaged", reason="file.cut")
    values = np.empty(len(words))
    for i, word in enumerate(words):
        try:
            values[i] = float(word)
        except ValueError:
            what = f"{quoted(word)} is not a number"
            raise error(what, file=file, record=record, remedy="correct the file", reason="number.malformed") from None
        if not np.isfinite(values[i]) or abs(values[i]) > LARGEST_NUMBER:
            what = "is not finite" if not np.isfinite(values[i]) else "is out of all range"
            message = f"{quoted(word)} {what}"
            raise error(message, file=file, record=record, remedy="correct the file", reason="number.out_of_range")
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
