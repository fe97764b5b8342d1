"""The service's database for the commands of its admins, and their entries in the audit log."""

import getpass
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from wayloom.errors import ConfigError

if TYPE_CHECKING:
    from wayloom.pipeline.settings import WayloomSettings
    from wayloom.store.database import Database, Session

T = TypeVar("T")
DataOption = Annotated[Path | None, typer.Option("--data", help="Data folder of the service. [default: wayloom-data]")]


@contextmanager
def admin_database(data: Path | None, config: Path | None) -> Iterator[tuple["Database", "WayloomSettings"]]:
    """The database that the settings name, and these. Raises ConfigError where there is none, or an older one."""
    from wayloom.config.sources import Option
    from wayloom.pipeline.settings import load_settings
    from wayloom.store.database import Database
    from wayloom.store.migrate import is_current

    settings = load_settings(config, Option("--data", "data_dir", data)).settings
    remedy = "start `wayloom up` or `python -m wayloom.store` once, or name the right --data or WAYLOOM_DATABASE_URL"
    if settings.database_url is None and not (settings.data_dir / "wayloom.db").is_file():
        raise ConfigError("no service has kept anything there", file=settings.data_dir, remedy=remedy)
    database = Database(settings.database)
    try:
        if not is_current(database):
            raise ConfigError("the service's database lacks migrations", remedy=remedy)
        yield database, settings
    finally:
        database.close()


def changed(database: "Database", action: str, change: Callable[["Session"], tuple[T, str]]) -> T:
    """Make a change and note it in the audit log, both or neither. change: returns its result and what it was about."""
    from wayloom.store.access.audit import Noted, append

    with database.write() as session:
        result, about = change(session)
        actor = f"command line of {getpass.getuser()}"
        append(session, [Noted(time.time(), actor, "admin", f"wayloom {action}", about, "this machine", 0, "done")])
    return result


def when(t_s: float | None) -> str | None:
    """UTC, to the second; None of never."""
    return None if t_s is None else datetime.fromtimestamp(t_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
