"""Every test of the store that asks for `database` runs on SQLite and on PostgreSQL."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from service_kit import postgres
from wayloom.store.database import Database
from wayloom.store.migrate import upgrade
from wayloom.store.tables.base import Base


@pytest.fixture(scope="session")
def postgres_folder() -> Iterator[str]:
    with postgres.cluster() as folder:
        yield folder


@pytest.fixture(scope="session")
def postgres_database(postgres_folder: str) -> Iterator[Database]:
    database = Database(postgres.new_database(postgres_folder))
    upgrade(database)
    yield database
    database.close()


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("template") / "wayloom.db"
    database = Database(f"sqlite:///{path}")
    upgrade(database)
    with database.engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    database.close()
    return path


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    if request.param == "sqlite":
        shutil.copy(request.getfixturevalue("sqlite_template"), tmp_path / "wayloom.db")
        found = Database(f"sqlite:///{tmp_path / 'wayloom.db'}")
        yield found
        found.close()
    else:
        found = request.getfixturevalue("postgres_database")
        yield found
        names = ", ".join(table.name for table in Base.metadata.sorted_tables)
        with found.engine.begin() as connection:
            connection.exec_driver_sql(f"TRUNCATE {names} RESTART IDENTITY CASCADE")


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def empty_database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    url = f"sqlite:///{tmp_path / 'empty.db'}" if request.param == "sqlite" else ""
    found = Database(url or postgres.new_database(request.getfixturevalue("postgres_folder")))
    yield found
    found.close()
