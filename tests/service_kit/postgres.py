"""A PostgreSQL server of our own on a Unix socket, from the binaries of the machine."""

import os
import pwd
import shutil
import subprocess
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def binaries() -> Path:
    """The newest installed server. None is a failure in CI and a skip elsewhere."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    on_path = shutil.which("initdb")
    if found or on_path:
        return (found[-1] if found else Path(str(on_path))).parent
    message = "no PostgreSQL server on this machine: install Debian's postgresql"
    if os.environ.get("CI"):
        pytest.fail(message)
    pytest.skip(message)


@contextmanager
def cluster() -> Iterator[str]:
    """A running server. Yields the folder of its socket."""
    programs = binaries()
    folder = Path(tempfile.mkdtemp(prefix="wayloom-pg-", dir="/tmp"))
    data = folder / "data"
    if os.geteuid() == 0:
        user = pwd.getpwnam("postgres")
        os.chown(folder, user.pw_uid, user.pw_gid)
    try:
        _run(programs / "initdb", "-D", data, "-A", "trust", "-U", "wayloom", "-E", "UTF8", "--no-sync")
        _start(folder)
        try:
            _prepare(str(folder))
            yield str(folder)
        finally:
            _run(programs / "pg_ctl", "-D", data, "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def stopped(folder: str) -> Iterator[None]:
    """A cluster whose processes are ended as by a loss of power, while this lasts."""
    data = Path(folder) / "data"
    _run(binaries() / "pg_ctl", "-D", data, "-m", "immediate", "-w", "stop")
    try:
        yield
    finally:
        _start(Path(folder))


def _start(folder: Path) -> None:
    options = f"-k {folder} -c listen_addresses='' -c fsync=off -c full_page_writes=off -c max_connections=50"
    _run(binaries() / "pg_ctl", "-D", folder / "data", "-l", folder / "log", "-o", options, "-w", "start")


def _prepare(folder: str) -> None:
    """PostGIS in the template, so that not every database takes the second to make the extension."""
    import psycopg

    with psycopg.connect(f"host={folder} user=wayloom dbname=template1", autocommit=True) as connection:
        connection.execute("CREATE EXTENSION postgis")


def url(folder: str, database: str) -> str:
    """The SQLAlchemy URL of a database of the cluster."""
    return f"postgresql+psycopg://wayloom@/{database}?host={folder}"


def new_database(folder: str) -> str:
    """The URL of a fresh database."""
    import psycopg

    name = f"t{uuid.uuid4().hex}"
    with psycopg.connect(f"host={folder} user=wayloom dbname=postgres", autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
    return url(folder, name)


def _run(*command: object) -> None:
    as_postgres = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    done = subprocess.run(
        [*as_postgres, *map(str, command)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd="/tmp",
    )
    if done.returncode:
        raise AssertionError(f"{command[0]}: {done.stdout}")
