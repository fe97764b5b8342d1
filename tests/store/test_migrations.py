"""The migrations and the models say the same."""

import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import Column, Integer, Table

from wayloom.store import drives, migrate
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import differences, is_current, migrations_dir, upgrade
from wayloom.store.tables.base import Base


def downgrade(database: Database, revision: str) -> None:
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.downgrade(config, revision)
        connection.commit()


def test_the_migrations_make_exactly_the_tables_of_the_models(empty_database: Database) -> None:
    upgrade(empty_database)
    assert differences(empty_database) == []


def test_a_database_is_current_only_after_the_last_migration(empty_database: Database) -> None:
    assert not is_current(empty_database)
    upgrade(empty_database)
    assert is_current(empty_database)


def test_a_model_without_a_migration_is_found(
    empty_database: Database, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["migrate", "--check"])
    assert migrate.main() == 0
    upgrade(empty_database)
    table = Table("forgotten", Base.metadata, Column("id", Integer, primary_key=True))
    try:
        assert [difference[0] for difference in differences(empty_database)] == ["add_table"]  # type: ignore[index]
        assert migrate.main() == 1
        assert "forgotten" in capsys.readouterr().err
    finally:
        Base.metadata.remove(table)


def test_migrating_twice_changes_nothing(empty_database: Database) -> None:
    upgrade(empty_database)
    upgrade(empty_database)
    assert differences(empty_database) == []


def test_taking_back_the_columns_of_images_leaves_drives_and_what_belongs_to_them(empty_database: Database) -> None:
    upgrade(empty_database)
    with empty_database.write() as session:
        drives.register(session, Manifest(name="drive", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),)), "city")
    downgrade(empty_database, "0017")
    with empty_database.engine.connect() as connection:
        counts = [connection.exec_driver_sql(f"SELECT count(*) FROM {table}").scalar() for table in ("drives", "drive_files")]
    assert counts == [1, 1]
    upgrade(empty_database)
    assert differences(empty_database) == []


def test_every_migration_can_be_taken_back(empty_database: Database) -> None:
    upgrade(empty_database)
    downgrade(empty_database, "base")
    assert not is_current(empty_database)
    upgrade(empty_database)
    assert differences(empty_database) == []
