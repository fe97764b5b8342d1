"""With what the command line ends: one table, which `wayloom --help` and docs/command-line.md show."""

from collections.abc import Mapping
from typing import Final

DONE: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
STOPPED: Final = 130

STATUSES: Final[Mapping[int, str]] = {
    DONE: "done",
    FAILED: "the work or a check failed, or a service that was asked is away",
    BAD_INPUT: "an option, a setting, a log or another file cannot be used",
    STOPPED: "stopped by Ctrl-C",
}


def epilog() -> str:
    """The table as the help's last lines."""
    return "Exit status: " + "; ".join(f"{status} {words}" for status, words in STATUSES.items())
