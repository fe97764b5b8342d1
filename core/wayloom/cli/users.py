"""`wayloom users`: people who sign in to the dashboard, in the database of the service."""

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.cli.admin_database import DataOption, admin_database, changed, when
from wayloom.cli.options import ConfigOption
from wayloom.cli.results import print_json
from wayloom.config.roles import Role

if TYPE_CHECKING:
    from wayloom.store.tables.access import User

group = typer.Typer(help="People who sign in to the dashboard. Prints JSON.", no_args_is_help=True)
Name = Annotated[str, typer.Argument(metavar="NAME", help="Small letters, digits, dots, dashes.")]
StdinOption = Annotated[bool, typer.Option("--password-stdin", help="Read the password from the first line of standard input.")]


@group.command("add")
def add_command(
    name: Name,
    role: Annotated[Role, typer.Option(help="What the user may do.")] = Role.VIEWER,
    password_stdin: StdinOption = False,
    data: DataOption = None,
    config: ConfigOption = None,
) -> None:
    """Add a user. The password is asked for, at least 12 letters."""
    from wayloom.store.access import users

    with admin_database(data, config) as (database, _):
        password = given_password(password_stdin)
        print_json(
            changed(database, "users add", lambda session: (shown(users.add(session, name, role, password)), f"user {name}"))
        )


@group.command("list")
def list_command(data: DataOption = None, config: ConfigOption = None) -> None:
    """Every user."""
    from wayloom.store.access import users

    with admin_database(data, config) as (database, _), database.read() as session:
        print_json([shown(row) for row in users.every(session)])


@group.command("password")
def password_command(name: Name, password_stdin: StdinOption = False, data: DataOption = None, config: ConfigOption = None) -> None:
    """Give a user another password: every session of the user ends."""
    from wayloom.store.access import users

    with admin_database(data, config) as (database, _):
        password = given_password(password_stdin)
        print_json(
            changed(
                database, "users password", lambda session: (shown(users.set_password(session, name, password)), f"user {name}")
            )
        )


@group.command("remove")
def remove_command(name: Name, data: DataOption = None, config: ConfigOption = None) -> None:
    """Remove a user and end every session of the user."""
    from wayloom.store.access import users

    with admin_database(data, config) as (database, _):
        print_json(changed(database, "users remove", lambda session: (shown(users.remove(session, name)), f"user {name}")))


@group.command("disable")
def disable_command(name: Name, data: DataOption = None, config: ConfigOption = None) -> None:
    """Keep a user out, also one whom an OpenID provider signs in, and end every session of the user."""
    from wayloom.store.access import users

    with admin_database(data, config) as (database, _):
        print_json(changed(database, "users disable", lambda session: (shown(users.disable(session, name)), f"user {name}")))


@group.command("enable")
def enable_command(name: Name, data: DataOption = None, config: ConfigOption = None) -> None:
    """Let a user who was disabled sign in again."""
    from wayloom.store.access import users

    with admin_database(data, config) as (database, _):
        print_json(changed(database, "users enable", lambda session: (shown(users.enable(session, name)), f"user {name}")))


def given_password(from_stdin: bool) -> str:
    """From standard input, or asked for twice without showing it. Never from the command line, where others would read it."""
    if from_stdin:
        return sys.stdin.readline().rstrip("\n")
    return str(typer.prompt("Password", hide_input=True, confirmation_prompt=True))


def shown(row: "User") -> dict[str, Any]:
    """A user without the password."""
    from wayloom.store.access import users

    return {
        "name": row.name, "role": row.role, "created": when(row.created_at), "signed_in": when(row.signed_in_at),
        "by": "oidc" if users.is_provided(row) else "password", "disabled": users.is_disabled(row),
    }  # fmt: skip
