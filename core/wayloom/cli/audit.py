"""`wayloom audit`: the audit log of the service."""

from enum import StrEnum
from typing import Annotated

import typer

from wayloom.cli.admin_database import DataOption, admin_database, when
from wayloom.cli.options import ConfigOption
from wayloom.cli.results import print_json

SHOWN = ("id", "at", "actor", "role", "action", "object", "address", "status", "outcome", "count")


class Outcome(StrEnum):
    """The end of a request."""

    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"


def audit_command(
    limit: Annotated[int, typer.Option(min=1, max=100_000, help="Most entries.")] = 100,
    before: Annotated[int | None, typer.Option(help="Only entries before this id.")] = None,
    actor: Annotated[str | None, typer.Option(help="Only of this one, as `key 0123456789ab` or `user anna`.")] = None,
    outcome: Annotated[Outcome | None, typer.Option(help="Only those that ended so.")] = None,
    data: DataOption = None,
    config: ConfigOption = None,
) -> None:
    """Who changed what in a service, and who was refused: JSON, newest first."""
    from wayloom.store.access import audit

    with admin_database(data, config) as (database, _), database.read() as session:
        rows = audit.page(session, limit, before, actor, None if outcome is None else outcome.value)
        print_json([{name: getattr(row, name) for name in SHOWN} | {"at": when(row.at)} for row in rows])
