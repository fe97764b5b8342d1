"""Progress reports of long work."""

from typing import Protocol


class Progress(Protocol):
    """Called with the share done, 0 to 1 and never falling, and a few words on what is being done. May raise to stop the work."""

    def __call__(self, share: float, what: str, /) -> None: ...


class NamedProgress(Protocol):
    """Gives the `Progress` of one piece of work among several (a stage, a file), by its name."""

    def __call__(self, name: str, /) -> Progress: ...


def silent(share: float, what: str, /) -> None:
    """A `Progress` for callers that do not want to know."""


def silent_for_each(name: str, /) -> Progress:
    """A `NamedProgress` for callers that do not want to know."""
    return silent
