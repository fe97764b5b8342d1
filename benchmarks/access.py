"""CPU of a request for a tile by how its caller is known: `python benchmarks/access.py`.

The application is called in this process, without a network: what is counted is its own work alone. `held`: the key or session is
in memory, as it is but for one request in `access.held_s`; `looked up`: the database is asked each time. Modes take turns.
"""

import asyncio
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from wayloom.config.access import AccessSettings
from wayloom.config.roles import Role
from wayloom.config.service import ServiceSettings
from wayloom.store import maps
from wayloom.store.access import keys, users
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, TileEntry, publish
from wayloom.store.migrate import upgrade
from wayloom_services.app import create_app

ROUNDS, REQUESTS = 15, 300
API_KEY = "a key for the benchmark"
RATE = {"requests_a_second": 1e9, "requests_at_once": 10**9}


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder, fleet(Path(folder)) as (key, token):
        bearer = [(b"authorization", f"Bearer {key}".encode())]
        modes = {
            "no key is wanted": (app(folder, None), []),
            "WAYLOOM_API_KEY": (app(folder, API_KEY), [(b"authorization", f"Bearer {API_KEY}".encode())]),
            "key, held": (app(folder, API_KEY), bearer),
            "session, held": (app(folder, API_KEY), [(b"cookie", f"wayloom={token}".encode())]),
            "key, looked up": (app(folder, API_KEY, held_s=0.0), bearer),
        }
        found = asyncio.run(measured(modes))
    print("| caller | CPU, ms a tile | more than without |\n| --- | --- | --- |")
    base = median(found["no key is wanted"])
    for name, taken in found.items():
        more = median(one - other for one, other in zip(taken, found["no key is wanted"], strict=True))
        print(f"| {name} | {median(taken):.3f} | {more:+.3f} ({more / base:+.0%}) |")


@contextmanager
def fleet(folder: Path) -> Iterator[tuple[str, str]]:
    """A map of one tile, a key that may read and a session that may."""
    database = Database(f"sqlite:///{folder / 'wayloom.db'}")
    upgrade(database)
    tile = TileEntry("semantic", 18, 1, 2, BlobStore(folder / "blobs").put(b"x" * 800), "image/png", 800)
    with database.write() as session:
        maps.ensure_map(session, "city")
        publish(session, "city", NewVersion(0, (8.5, 49.5, 0.0), (), 1, None, [tile]), kept=9)
        row, key = keys.create(session, "benchmark", Role.VIEWER)
        keys.note_use(session, row.id)
        token = users.sign_in(session, users.add(session, "anna", Role.VIEWER, "a good long password"), "", 3600.0)
    yield key, token
    database.close()


def app(folder: str, key: str | None, **access: float) -> Any:
    """The service on the fleet's folder."""
    return create_app(ServiceSettings(data_dir=Path(folder), api_key=key, access=AccessSettings(**RATE, **access)))


async def measured(modes: dict[str, tuple[Any, list[tuple[bytes, bytes]]]]) -> dict[str, list[float]]:
    """Milliseconds of CPU a request, of each round; the first round warms up."""
    found: dict[str, list[float]] = {name: [] for name in modes}
    for turn in range(ROUNDS + 1):
        for name, (served, headers) in modes.items():
            started = time.process_time()
            for _ in range(REQUESTS):
                assert await status(served, headers) == 200
            if turn:
                found[name].append(1e3 * (time.process_time() - started) / REQUESTS)
    return found


async def status(served: Any, headers: list[tuple[bytes, bytes]]) -> int:
    """Of one request for the tile."""
    path = "/v1/maps/city/tiles/semantic/18/1/2.png"
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "GET", "scheme": "http", "path": path,
        "raw_path": path.encode(), "query_string": b"", "root_path": "", "headers": [(b"host", b"localhost"), *headers],
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 80), "state": {},
    }  # fmt: skip
    said: list[int] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        said.append(message.get("status", 0))

    await served(scope, receive, send)
    return said[0]


if __name__ == "__main__":
    main()
