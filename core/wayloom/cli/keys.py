"""`wayloom keys`: keys of vehicles and programs, in the database of the service."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.cli.admin_database import DataOption, admin_database, changed, when
from wayloom.cli.options import ConfigOption
from wayloom.cli.results import print_json
from wayloom.config.roles import Role

if TYPE_CHECKING:
    from wayloom.store.tables.access import AccessKey

DAY_S = 86400.0
group = typer.Typer(help="Keys of vehicles and programs, in the database of the service. Prints JSON.", no_args_is_help=True)
Prefix = Annotated[str, typer.Argument(metavar="PREFIX", help="Public part of the key, the 12 digits after wlk_.")]


@group.command("create")
def create_command(
    name: Annotated[str, typer.Argument(help="What the key is for.")],
    role: Annotated[Role, typer.Option(help="What it may do.")] = Role.VEHICLE,
    vehicle: Annotated[str | None, typer.Option(help="The vehicle whose drives alone it sends.")] = None,
    days: Annotated[float | None, typer.Option(min=0.0001, help="Days until it expires. [default: never]")] = None,
    data: DataOption = None,
    config: ConfigOption = None,
) -> None:
    """Make a key. Its text is shown this once: `key` of what is printed."""
    from wayloom.store.access import keys

    with admin_database(data, config) as (database, _):

        def change(session: Any) -> tuple[dict[str, Any], str]:
            row, text = keys.create(session, name, role, vehicle, None if days is None else days * DAY_S)
            return shown(row) | {"key": text}, f"key {row.prefix}"

        print_json(changed(database, "keys create", change))


@group.command("list")
def list_command(data: DataOption = None, config: ConfigOption = None) -> None:
    """Every key, newest first, those that are revoked too; without secrets."""
    from wayloom.store.access import keys

    with admin_database(data, config) as (database, _), database.read() as session:
        print_json([shown(row) for row in keys.every(session)])


@group.command("rotate")
def rotate_command(
    prefix: Prefix,
    grace_hours: Annotated[
        float | None,
        typer.Option(min=0, help="Hours for which the secret before is still taken. [default: access.rotation_grace_s]"),
    ] = None,
    data: DataOption = None,
    config: ConfigOption = None,
) -> None:
    """Give the key a new secret; the one before is taken for a while."""
    from wayloom.store.access import keys

    with admin_database(data, config) as (database, settings):
        grace_s = settings.access.rotation_grace_s if grace_hours is None else grace_hours * 3600.0

        def change(session: Any) -> tuple[dict[str, Any], str]:
            row, text = keys.rotate(session, prefix, grace_s)
            return shown(row) | {"key": text}, f"key {prefix}"

        print_json(changed(database, "keys rotate", change))


@group.command("revoke")
def revoke_command(prefix: Prefix, data: DataOption = None, config: ConfigOption = None) -> None:
    """Revoke the key: a running service takes it for `access.held_s` (10 s) more at most."""
    from wayloom.store.access import keys

    with admin_database(data, config) as (database, _):
        print_json(changed(database, "keys revoke", lambda session: (shown(keys.revoke(session, prefix)), f"key {prefix}")))


def shown(row: "AccessKey") -> dict[str, Any]:
    """A key without its secret."""
    times = {"created": row.created_at, "expires": row.expires_at, "used": row.used_at, "revoked": row.revoked_at}
    about = {"prefix": row.prefix, "name": row.name, "role": row.role, "vehicle_id": row.vehicle_id}
    return about | {name: when(t_s) for name, t_s in times.items()} | {"rotated_until": when(row.old_until)}
