"""Database access, SQLite or PostgreSQL: short read and write transactions, and the database's own clock."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, func, make_url, select
from sqlalchemy.exc import OperationalError, SQLAlchemyError
from sqlalchemy.orm import Session
from sqlalchemy.pool import ConnectionPoolEntry

__all__ = ["Database", "DatabaseAwayError", "DatabaseError", "Session", "now_s"]
DatabaseError = SQLAlchemyError
"""Whatever goes wrong between wayloom and its database."""
DatabaseAwayError = OperationalError
"""The database cannot be reached, is locked for too long, or its disk is full."""
BUSY_TIMEOUT_MS = 30_000
CACHE_KB = 256
"""Of pages, for each connection: an API process opens up to 30, of which SQLite would keep 2 MB each."""
PRAGMAS = ("journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON", "secure_delete=ON", f"cache_size=-{CACHE_KB}")
"""Of SQLite; what is deleted is overwritten: a row that is gone shall not be read from the file."""


class Database:
    """SQLite (WAL) or PostgreSQL behind the same tables. Safe to share between threads; never across a fork (call `forget`)."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.dialect = make_url(url).get_backend_name()
        self.engine = _sqlite_engine(url) if self.dialect == "sqlite" else create_engine(url, pool_pre_ping=True)
        self._writing = self.engine.execution_options(wayloom_begin="BEGIN IMMEDIATE")

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A transaction that only looks."""
        with Session(self.engine, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """A transaction that commits at the end of the block, rolls back on an error. SQLite is locked from the start."""
        with Session(self._writing, expire_on_commit=False) as session, session.begin():
            yield session

    @cached_property
    def lookups(self) -> Engine:
        """Connections for single statements that only look: no transaction around them, and none is asked whether it lives. Who
        uses them tries once more where one was dead (`DBAPIError.connection_invalidated`)."""
        if self.dialect == "sqlite":
            return _sqlite_engine(self.url, begins=False)
        return create_engine(self.url, isolation_level="AUTOCOMMIT", pool_reset_on_return=None)

    def settle(self) -> None:
        """Have SQLite write its log into its file and cut it off, if nobody reads just now: what was deleted is in neither then."""
        if self.dialect == "sqlite":
            with self.lookups.connect() as connection:
                connection.exec_driver_sql("PRAGMA busy_timeout=0")
                connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
                connection.exec_driver_sql(f"PRAGMA busy_timeout={BUSY_TIMEOUT_MS}")

    def forget(self) -> None:
        """Drop every connection without closing it: to be called in the child after a fork."""
        for engine in self._engines():
            engine.dispose(close=False)

    def close(self) -> None:
        """Close every connection."""
        for engine in self._engines():
            engine.dispose()

    def _engines(self) -> list[Engine]:
        return [self.engine, *([self.lookups] if "lookups" in self.__dict__ else [])]


def now_s(session: Session) -> float:
    """Seconds since 1970 by the clock of the database, so that leases of several machines are on one clock."""
    if session.get_bind().dialect.name == "sqlite":
        return time.time()  # SQLite has no server: its clock is this machine's
    return float(session.execute(select(func.extract("epoch", func.clock_timestamp()))).scalar_one())


def _sqlite_engine(url: str, begins: bool = True) -> Engine:
    """SQLite as a server would want it: WAL, foreign keys, waiting for the lock, and transactions that SQLAlchemy begins itself."""
    database = make_url(url).database
    if database and database != ":memory:":
        Path(database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(url, connect_args={"timeout": BUSY_TIMEOUT_MS / 1000})

    @event.listens_for(engine, "connect")
    def _prepare(connection: Any, _entry: ConnectionPoolEntry) -> None:
        connection.isolation_level = None  # the driver's own BEGIN would come too late and be deferred
        for pragma in (*PRAGMAS, f"busy_timeout={BUSY_TIMEOUT_MS}"):
            connection.execute(f"PRAGMA {pragma}")
        connection.create_function("lower", 1, _lower, deterministic=True)  # SQLite's own knows ASCII alone

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        if begins:
            connection.exec_driver_sql(connection.get_execution_options().get("wayloom_begin", "BEGIN"))

    return engine


def _lower(text: Any) -> Any:
    """SQL's `lower` as PostgreSQL has it, of texts in any script."""
    return text.lower() if isinstance(text, str) else text
