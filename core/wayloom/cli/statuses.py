"""With what the command line ends: one table, which `wayloom --help` and docs/command-line.md show."""

from collections.abc import Mapping
from typing import Final

DONE: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
STOPPED: Final = 130

STATUSES: Final[Mapping[int, str]] = {
    DONE: "done; what was lost or held on the way is said, and is no failure",
    FAILED: "the work failed, or a service that was asked said so or is away",
    BAD_INPUT: "bad input: an option, a setting, a log or another file that cannot be used; one line says which and what helps",
    STOPPED: "stopped by Ctrl-C",
}


def epilog() -> str:
    """The table as the help's last lines."""
    return "Exit status: " + "; ".join(
        f"{status} {words.partition(';')[0].partition(':')[0]}" for status, words in STATUSES.items()
    )
