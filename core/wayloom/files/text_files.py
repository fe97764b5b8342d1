"""Text file parsing with errors that name file, line and remedy."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError, LogError
from wayloom.files.regular import IrregularFileError, LargeFileError, read_regular

FloatArray = NDArray[np.float64]
QUOTE_CHARACTERS = 40
LARGEST_NUMBER = 1e12


def quoted(text: str) -> str:
    """Text from a file as it may stand in a message: on one line, quoted, not longer than QUOTE_CHARACTERS."""
    shown = text if len(text) <= QUOTE_CHARACTERS else text[:QUOTE_CHARACTERS] + "…"
    return repr(shown)


def utf8_text(of_path: str) -> str:
    """A path's text as UTF-8 can hold it: bytes that are none (names from other systems) become replacement characters."""
    return of_path.encode(errors="surrogateescape").decode(errors="replace")


def read_bytes(file: Path, *, remedy: str, error: type[InputError] = LogError) -> bytes:
    """The bytes of a file. Raises `error`, with the remedy, where it is missing, and says why where it cannot be read."""
    try:
        return read_regular(file)
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
    data = read_bytes(file, remedy=remedy, error=error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        what = f"byte {problem.start} is not UTF-8 text"
        raise error(what, file=file, remedy="the file is damaged: copy it again from the vehicle", reason="file.not_text") from None


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
        raise error(
            f"{len(words)} numbers where {count} belong",
            file=file,
            record=record,
            remedy="the line is cut or damaged",
            reason="file.cut",
        )
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
