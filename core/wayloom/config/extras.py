"""Extras of the installation: packages that only some commands and functions need, and the one error where they are absent."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from wayloom.errors import MissingExtraError

EXTRAS: Final[dict[str, str]] = {
    "convert": "onnx",
    "geo": "geopandas",
    "oidc": "authlib and joserfc",
    "parquet": "pyarrow",
    "rerun": "rerun-sdk",
}
"""What each brings."""


def remedy_of(extra: str) -> str:
    """The command that installs an extra."""
    return f"pip install 'wayloom[{extra}]'"


def missing_extra(extra: str, what: str, file: Path | None = None) -> MissingExtraError:
    """The error for `what` (a noun in the singular) that needs an extra which is not installed."""
    return MissingExtraError(f"{what} needs {EXTRAS[extra]}, which is not installed", file=file, remedy=remedy_of(extra))


@contextmanager
def from_extra(extra: str, what: str, file: Path | None = None) -> Iterator[None]:
    """Import an extra's packages within. Raises MissingExtraError where one of them, or one that they need, is not installed; what
    is installed and broken raises its own ImportError, which says what it lacks."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.partition(".")[0] == "wayloom":
            raise
        raise missing_extra(extra, what, file) from error
