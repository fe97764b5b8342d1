"""Migration of a database to the newest tables, and the check whether it is needed."""

import argparse
import sys
import tempfile
from pathlib import Path

from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from wayloom.store.database import Database
from wayloom.store.spatial.derived import is_of_models, missing
from wayloom.store.spatial.readers import grant_again
from wayloom.store.tables.base import Base


def migrations_dir() -> Path:
    """The migrations: beside this module in an installed wheel, at the top of a checkout."""
    installed = Path(__file__).parent / "migrations"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "migrations"


def upgrade(database: Database) -> None:
    """Run every migration that the database has not seen, in one transaction."""
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "head")
        grant_again(connection)
        connection.commit()


def is_current(database: Database) -> bool:
    """Whether the database has seen every migration."""
    script = ScriptDirectory(str(migrations_dir()))
    with database.engine.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision() == script.get_current_head()


def differences(database: Database) -> list[object]:
    """What the tables of the models, or what the database derives from them, have that it has not, or the other way round."""
    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "include_object": is_of_models})
        return [*compare_metadata(context, Base.metadata), *(("missing", name) for name in missing(connection))]


def main() -> int:
    """`python -m wayloom.store.migrate --check`: whether the migrations make exactly the tables of the models."""
    parser = argparse.ArgumentParser(prog="python -m wayloom.store.migrate")
    parser.add_argument(
        "--check", action="store_true", required=True, help="compare migrations and models in a database of its own"
    )
    parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        database = Database(f"sqlite:///{folder}/check.db")
        upgrade(database)
        found = differences(database)
        database.close()
    for difference in found:
        sys.stderr.write(f"wayloom: the migrations lack {difference}\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
