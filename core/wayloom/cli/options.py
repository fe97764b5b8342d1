"""Options that several commands share."""

import os
from pathlib import Path
from typing import Annotated, Final

import typer

from wayloom.errors import ConfigError

SERVER_VARIABLE: Final = "WAYLOOM_SERVER"
SERVER_HELP: Final = f"Address of the service, e.g. http://127.0.0.1:8088; also by {SERVER_VARIABLE}."
ToOption = Annotated[
    str, typer.Option("--to", "--server", metavar="URL", envvar=SERVER_VARIABLE, show_envvar=False, help=SERVER_HELP)
]
FromOption = Annotated[str | None, typer.Option("--from", "--server", metavar="URL", help=SERVER_HELP)]
"""Of commands that may do without a service, or take its address as an argument: see `known_server` and `server_of`."""
ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", help="Settings file (TOML), also by WAYLOOM_CONFIG; `wayloom config show` prints what is in force."),
]


def known_server(*given: str | None) -> str | None:
    """The address of a service that was given in one place, else that of WAYLOOM_SERVER, if any. Raises ConfigError for two."""
    told = [url for url in given if url is not None]
    if len(told) > 1:
        raise ConfigError(f"the service is named twice, {told[0]} and {told[1]}", remedy="leave one of the two out")
    return told[0] if told else os.environ.get(SERVER_VARIABLE) or None


def server_of(*given: str | None) -> str:
    """`known_server`. Raises ConfigError where there is none."""
    if (url := known_server(*given)) is None:
        raise ConfigError("no service is named", remedy=f"give --server http://HOST:8088, or set {SERVER_VARIABLE}")
    return url


def server_and_last(words: list[str], last: str, option: str | None) -> tuple[str, str]:
    """The address of a service, and what LAST is, of the arguments `[URL] LAST`. Raises ConfigError."""
    if len(words) > 2 or is_url(words[-1]):
        raise ConfigError(f"{' '.join(words)} is not [URL] {last}", remedy=f"give {last} after the address of the service")
    return server_of(*words[:-1], option), words[-1]


def is_url(word: str) -> bool:
    """Whether a word is an address, also one that has become a path and lost a stroke."""
    return word.startswith(("http:", "https:"))


def default_threads() -> int:
    """The cores that this process may use."""
    return min(64, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
