"""The same service on the other column: PostgreSQL for SQLite, a Redis server of the machine for the bundled Valkey."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from redis import Redis
from redis.exceptions import RedisError

from service_kit import postgres
from service_kit.packed_drives import packed_drive
from service_kit.running import service, until
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive


@pytest.fixture
def redis_url(tmp_path: Path) -> Iterator[str]:
    program = shutil.which("redis-server") or shutil.which("valkey-server")
    if program is None:
        message = "no Redis server on this machine: install Debian's redis-server"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    socket = tmp_path / "redis.sock"
    command = [program, "--port", "0", "--unixsocket", str(socket), "--save", "", "--appendonly", "no", "--dir", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        with Redis(unix_socket_path=str(socket)) as client:
            until(lambda: answers(client))
        yield f"redis+socket://{socket}"
    finally:
        process.terminate()
        process.wait(10)


def answers(client: Redis) -> bool:
    try:
        return bool(client.ping())
    except RedisError:
        return False


@pytest.mark.postgres
def test_a_drive_survives_a_killed_worker_on_postgresql_and_redis_too(tmp_path: Path, redis_url: str) -> None:
    with postgres.cluster() as folder:
        variables = {"WAYLOOM_DATABASE_URL": postgres.new_database(folder), "WAYLOOM_BROKER_URL": redis_url}
        with service(tmp_path / "data", "--workers", "2", **variables) as up:
            assert not (tmp_path / "data" / "wayloom.db").exists()
            assert up.children("valkey-server") == []
            api = up.api()
            first = upload(api, packed_drive(tmp_path / "a", "first", {"odometry": {"seconds": 1.0}}))["id"]
            second = upload(api, packed_drive(tmp_path / "b", "second"))["id"]
            until(lambda: api.drive(first)["stages"][1]["progress"] > 0.2)
            for pid in up.children("wayloom_workers worker"):
                up.kill_process(pid)
            assert wait_for_drive(api, first)["state"] == "done"
            assert wait_for_drive(api, second)["state"] == "done"
            ingest, tracked = api.drive(first)["stages"][:2]
            assert (tracked["attempt"], len(tracked["losses"])) == (1, 1)
            assert (ingest["attempt"], len(ingest["losses"])) == (1, 0)
            assert set(api.json("GET", "/v1/maps/city")["drives"]) == {first, second}
