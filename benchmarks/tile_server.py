"""Tiles a second from a real API process, and how long its readers wait: on SQLite and PostgreSQL, beside another source tree's.

python benchmarks/tile_server.py [--against SOURCE_TREE] [--readers 50] [--seconds 6] [--write]

`viewers`: each reader asks for 4 tiles a second on a connection of its own, as a map that is looked at does. `flood`: each asks
again as soon as it has its answer, so that what one waits is the readers over the rate. Readers and server share the cores.
`first`: no tile was asked for since the server started; `again`: they come from its memory.
"""

import argparse
import asyncio
import itertools
import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "tiles"))

from made_maps import made_map, made_tracks

from pages import put_between_marks
from service_kit import postgres, running
from service_kit.made_version import publish_map
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.map_versions import TileEntry
from wayloom.store.migrate import upgrade
from wayloom.tiles.descriptions import SUFFIXES

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("semantic", "features", "points")
"""Which the servers of all source trees have."""
PAGE = ROOT / "docs" / "benchmarks" / "tiles.md"
HEAD = "| database | source | load | tiles/s | p50, ms | p95, ms | CPU of the server, ms a tile |"
RULE = "| --- | --- | --- | --- | --- | --- | --- |"
PACE = 4.0
"""Tiles a second of a reader in the load `viewers`."""


@dataclass(frozen=True)
class Run:
    """One measurement: which server and load; requests a second; waiting time, ms; the server's CPU, ms a request."""

    database: str
    tree: str
    load: str
    rate: float
    p50_ms: float
    p95_ms: float
    cpu_ms: float

    def row(self) -> str:
        numbers = f"{self.rate:.0f} | {self.p50_ms:.1f} | {self.p95_ms:.1f} | {self.cpu_ms:.2f}"
        return f"| {self.database} | {self.tree} | {self.load} | {numbers} |"


class Reader:
    """One connection that is kept."""

    def __init__(self, port: int) -> None:
        self.port = port

    async def open(self) -> None:
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port)

    async def ask(self, path: str) -> float:
        """Seconds until the whole answer is there."""
        start = time.perf_counter()
        self.writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        head = await self.reader.readuntil(b"\r\n\r\n")
        if not head.startswith(b"HTTP/1.1 200"):
            raise SystemExit(f"{path}: {head[:200]!r}")
        length = head.lower().split(b"content-length:", 1)[1].split(b"\r\n", 1)[0]
        await self.reader.readexactly(int(length))
        return time.perf_counter() - start


async def load(port: int, paths: list[list[str]], pace: float | None) -> list[float]:
    """Each reader asks for its own paths in order; pace: so many a second, None as fast as it can."""
    readers = [Reader(port) for _ in paths]
    await asyncio.gather(*(one.open() for one in readers))
    waits: list[float] = []
    begun = time.perf_counter()

    async def reading(one: Reader, own: list[str], late: float) -> None:
        for turn, path in enumerate(own):
            if pace is not None:
                await asyncio.sleep(max(begun + (turn + late) / pace - time.perf_counter(), 0.0))
            waits.append(await one.ask(path))
        one.writer.close()

    await asyncio.gather(
        *(reading(one, own, row / len(readers)) for row, (one, own) in enumerate(zip(readers, paths, strict=True)))
    )
    return waits


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measured(alone: running.ApiAlone, paths: list[list[str]], pace: float | None, about: tuple[str, str, str]) -> Run:
    port, before, start = int(alone.url.rpartition(":")[2]), cpu_s(alone.process.pid), time.perf_counter()
    waits = np.array(asyncio.run(load(port, paths, pace))) * 1000.0
    seconds, cpu = time.perf_counter() - start, cpu_s(alone.process.pid) - before
    p50, p95 = np.percentile(waits, [50, 95]).tolist()
    return Run(*about, len(waits) / seconds, p50, p95, 1000.0 * cpu / len(waits))


@contextmanager
def server(folder: Path, tree: Path, url: str) -> Iterator[running.ApiAlone]:
    """The API of a source tree on a data folder."""
    paths = os.pathsep.join(str(tree / name) for name in ("core", "services", "workers"))
    with closing(running.ApiAlone(folder, WAYLOOM_DATABASE_URL=url, PYTHONPATH=paths)) as alone:
        running.until(lambda: _answers(alone))
        yield alone


def _answers(alone: running.ApiAlone) -> bool:
    import httpx2

    try:
        return httpx2.get(f"{alone.url}/healthz", trust_env=False).status_code == 200
    except httpx2.HTTPError:
        return False


def dealt(entries: list[TileEntry], readers: int, each: int, seed: int) -> list[list[str]]:
    """Paths for each reader; none twice before all were asked for."""
    order = random.Random(seed).sample(entries, len(entries))
    endless = itertools.cycle(f"/v1/maps/city/tiles/{one.layer}/{one.z}/{one.x}/{one.y}{SUFFIXES[one.layer]}" for one in order)
    return [list(itertools.islice(endless, each)) for _ in range(readers)]


def runs_on(
    name: str, url: str, folder: Path, trees: dict[str, Path], entries: list[TileEntry], options: argparse.Namespace
) -> Iterator[Run]:
    """The loads on each source tree in turn, on one database."""
    readers, each = options.readers, max(len(entries) // options.readers, 1)
    for tree, source in trees.items():
        with server(folder, source, url) as alone:
            yield measured(alone, dealt(entries, readers, each, 0), None, (name, tree, "flood, first"))
            again = dealt(entries, readers, each, 1)
            yield measured(alone, again, None, (name, tree, "flood, again"))
        with server(folder, source, url) as alone:
            slow = min(each, int(options.seconds * PACE))
            measured(alone, [dealt(entries, 1, 1, 3)[0]], None, (name, tree, "the first of all"))
            yield measured(alone, dealt(entries, readers, slow, 2), PACE, (name, tree, "viewers, first"))
            yield measured(alone, dealt(entries, readers, slow, 2), PACE, (name, tree, "viewers, again"))


def main() -> None:
    """Measure, print, write the page where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="source tree of another state of this repository")
    parser.add_argument("--readers", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--voxels", type=int, default=40_000)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    options = parser.parse_args()
    trees = ({} if options.against is None else {"before": options.against.resolve()}) | {"now": ROOT}
    city = made_map(options.voxels, extent_m=500.0)
    found: list[Run] = []
    with tempfile.TemporaryDirectory() as text, postgres.cluster() as cluster:
        folder = Path(text)
        for name, url in (("SQLite", f"sqlite:///{folder / 'wayloom.db'}"), ("PostgreSQL", postgres.new_database(cluster))):
            database = Database(url)
            upgrade(database)
            entries = publish_map(database, BlobStore(folder / "blobs"), city, made_tracks(city))
            database.close()
            asked = [one for one in entries if one.layer in LAYERS]
            for run in runs_on(name, url, folder, trees, asked, options):
                print(run.row(), flush=True)
                found.append(run)
    if options.write:
        sizes = np.array([one.size for one in asked])
        about = f"{len(asked)} tiles of {sizes.mean() / 1000:.1f} kB in the mean, {options.readers} readers"
        busy = f"{os.cpu_count()} cores, load average {os.getloadavg()[1]:.1f}"
        rows = [HEAD, RULE, *(run.row() for run in found)]
        put_between_marks(PAGE, "server", f"{about}; {busy}.\n\n" + "\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
