"""Roles of a PostgreSQL database that may read geometry and nothing else."""

from typing import Final

from sqlalchemy import Connection, text
from sqlalchemy.exc import DBAPIError

from wayloom.errors import ConfigError, InputError
from wayloom.store.database import Database
from wayloom.store.spatial.derived import DRIVE_TRACKS
from wayloom.store.spatial.feature_tables import FEATURE_TABLES

READABLE: Final = (DRIVE_TRACKS, "submaps", *(one.table.name for one in FEATURE_TABLES))
"""Tables and views with geometry: of the drives a view, since their table holds manifests."""


def grant_readonly(database: Database, role: str) -> None:
    """Let a role that exists read the geometry, and let its transactions write nothing by default.

    Raises ConfigError on SQLite, InputError where there is no such role or it could read more than that anyway.
    """
    if database.dialect != "postgresql":
        raise ConfigError("SQLite has no roles", remedy="name a PostgreSQL database by WAYLOOM_DATABASE_URL")
    with database.engine.begin() as connection:
        _check(connection, role)
        _grant(connection, role)
        try:
            with connection.begin_nested():
                connection.execute(text(f"ALTER ROLE {_quoted(connection, role)} SET default_transaction_read_only = on"))
        except DBAPIError:  # only who may change the role can: it still may write nothing, it is only told so later
            pass


def grant_again(connection: Connection) -> None:
    """After a migration: those that read the drives' tracks may read the tables that have come as well."""
    if connection.dialect.name == "postgresql":
        query = "SELECT DISTINCT grantee FROM information_schema.role_table_grants WHERE table_name = :name AND grantee <> grantor"
        for role in sorted(connection.scalars(text(query), {"name": DRIVE_TRACKS})):
            _grant(connection, role)


def _grant(connection: Connection, role: str) -> None:
    schema = _quoted(connection, str(connection.scalar(text("SELECT current_schema()"))))
    connection.execute(text(f"GRANT USAGE ON SCHEMA {schema} TO {_quoted(connection, role)}"))
    connection.execute(text(f"GRANT SELECT ON {', '.join(READABLE)} TO {_quoted(connection, role)}"))


def _check(connection: Connection, role: str) -> None:
    if not connection.scalar(text("SELECT 1 FROM pg_roles WHERE rolname = :role"), {"role": role}):
        remedy = f"make it first: CREATE ROLE {_quoted(connection, role)} LOGIN PASSWORD '…'"
        raise InputError("there is no such role in the database", file=role, remedy=remedy)
    if connection.scalar(text("SELECT has_table_privilege(:role, 'jobs', 'SELECT')"), {"role": role}):
        raise InputError("may read or write all tables already", file=role, remedy="give a role of its own")


def _quoted(connection: Connection, name: str) -> str:
    return connection.dialect.identifier_preparer.quote_identifier(name)
