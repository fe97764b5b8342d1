"""The migrations and the models say the same."""

from alembic import command
from alembic.config import Config

from wayloom.store.database import Database
from wayloom.store.migrate import differences, is_current, migrations_dir, upgrade


def test_the_migrations_make_exactly_the_tables_of_the_models(empty_database: Database) -> None:
    upgrade(empty_database)
    assert differences(empty_database) == []


def test_a_database_is_current_only_after_the_last_migration(empty_database: Database) -> None:
    assert not is_current(empty_database)
    upgrade(empty_database)
    assert is_current(empty_database)


def test_migrating_twice_changes_nothing(empty_database: Database) -> None:
    upgrade(empty_database)
    upgrade(empty_database)
    assert differences(empty_database) == []


def test_every_migration_can_be_taken_back(empty_database: Database) -> None:
    upgrade(empty_database)
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    with empty_database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.downgrade(config, "base")
        connection.commit()
    assert not is_current(empty_database)
    upgrade(empty_database)
    assert differences(empty_database) == []
