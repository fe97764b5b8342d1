"""Speed of an upload over loopback beside a copy that is as safe: `cp`, SHA-256 of the copy, a flush.

python benchmarks/upload.py [--rounds 3] [--cases ...] [--ways tus packs] [--write]

Each round makes new files, then in turn copies them, sends them file by file (tus) and in packs (as the client does), to one API
process on SQLite. `ratio` is the copy's time over the upload's, of the same round; median and best of the rounds are told. The
upload's time begins with the manifest known and ends with every file verified, durable and registered. Files of rounds that are
over are emptied, not removed: ext4 hands out no inode that was removed in the last minutes, and whoever makes a file has to look at
each of them, which with thousands of them takes more time than to send the files.
"""

import argparse
import hashlib
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pages import DOCS, put_between_marks
from service_kit.running import ApiAlone, until
from wayloom.client.api import Api
from wayloom.client.manifests import PackedDrive, hash_file
from wayloom.client.upload import upload
from wayloom.store.manifest import Manifest, ManifestFile

PAGE = DOCS / "benchmarks" / "upload.md"
CASES = {"1 x 500 MB": (1, 500_000_000), "2000 x 250 kB": (2000, 250_000), "2000 x 20 kB": (2000, 20_000)}
HEAD = (
    "| files | way | copy, s | upload, s | ratio: median | best | MB/s | API's CPU, ms a file | API's CPU, ms a MB "
    "| client's CPU, ms a MB |"
)
RULE = "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
TICK = os.sysconf("SC_CLK_TCK")
GIGABYTE = 10**9


@dataclass(frozen=True)
class Run:
    """One upload of one round: seconds of the copy and of the upload, CPU seconds of the API and of the client."""

    copy_s: float
    upload_s: float
    api_s: float
    client_s: float


def make_files(folder: Path, count: int, size: int) -> PackedDrive:
    """Random files and their manifest."""
    (folder / "image_0").mkdir(parents=True)
    sources = {f"log/image_0/{i:06}.png": folder / "image_0" / f"{i:06}.png" for i in range(count)}
    for source in sources.values():
        source.write_bytes(os.urandom(size))
    return describe(sources)


def describe(sources: dict[str, Path]) -> PackedDrive:
    known = {source: hash_file(source) for source in set(sources.values())}
    files = tuple(ManifestFile(path=path, size=known[source][0], sha256=known[source][1]) for path, source in sources.items())
    return PackedDrive(Manifest(name=f"drive {time.time_ns()}", files=files), sources)


def copy(source: Path, target: Path) -> float:
    """Seconds of `cp`, of hashing the copy, and of a flush."""
    os.sync()
    started = time.perf_counter()
    subprocess.run(["cp", "-r", source, target], check=True)
    for path in sorted(path for path in target.rglob("*") if path.is_file()):
        with path.open("rb") as file:
            hashlib.file_digest(file, "sha256").hexdigest()
    subprocess.run(["sync", "-f", target], check=True)
    return time.perf_counter() - started


def send(server: ApiAlone, api: Api, drive: PackedDrive, packs: bool) -> tuple[float, float, float]:
    """Seconds, CPU seconds of the API, CPU seconds of the client."""
    os.sync()
    started, api_s, client_s = time.perf_counter(), cpu_s(server.process.pid), time.process_time()
    registration = upload(api, drive, packs=packs)
    took = time.perf_counter() - started, cpu_s(server.process.pid) - api_s, time.process_time() - client_s
    assert registration["missing"] == []
    return took


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def memory_mb(pid: int, what: str) -> float:
    """Memory of a process: `VmRSS`, what it holds, or `VmHWM`, the most that it has held."""
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith(what))
    return int(line.split()[1]) * 1024 / 1e6


def one_round(server: ApiAlone, api: Api, folder: Path, ways: list[str], count: int, size: int) -> dict[str, Run]:
    runs = {}
    for way in ways:
        source = Path(tempfile.mkdtemp(dir=folder))
        drive = make_files(source, count, size)
        target = Path(tempfile.mkdtemp(dir=folder)) / "copy"
        copied = copy(source, target)
        empty(target)
        runs[way] = Run(copied, *send(server, api, drive, way == "packs"))
        empty(source)
        empty(server.data / "drives" / drive.manifest.drive_id)
    return runs


def empty(folder: Path) -> None:
    """Give the space of a folder's files back, and keep the files."""
    for path in folder.rglob("*"):
        if path.is_file():
            os.truncate(path, 0)


def row(name: str, way: str, runs: list[Run]) -> str:
    count, size = CASES[name]
    megabytes = count * size / 1e6
    median = {field: statistics.median(getattr(run, field) for run in runs) for field in Run.__dataclass_fields__}
    ratios = [100 * run.copy_s / run.upload_s for run in runs]
    ratio = f"{statistics.median(ratios):.0f} % | {max(ratios):.0f} %"
    numbers = f"{median['copy_s']:.2f} | {median['upload_s']:.2f} | {ratio} | {megabytes / median['upload_s']:.0f}"
    cpu = [1e3 * median["api_s"] / count, 1e3 * median["api_s"] / megabytes, 1e3 * median["client_s"] / megabytes]
    return f"| {name} | {way} | {numbers} | {' | '.join(f'{one:.2f}' for one in cpu)} |"


def send_and_remove(server: ApiAlone, api: Api, sources: dict[str, Path]) -> None:
    """Send a drive of these files, as the client does, and delete what has arrived."""
    drive = describe(sources)
    assert upload(api, drive)["missing"] == []
    shutil.rmtree(server.data / "drives" / drive.manifest.drive_id)


@contextmanager
def servers(folder: Path) -> Iterator[Callable[[], ApiAlone]]:
    """Fresh API processes, ended with the block."""
    started: list[ApiAlone] = []

    def start() -> ApiAlone:
        server = ApiAlone(folder / f"data {len(started)}")
        started.append(server)
        with Api(server.url) as api:
            until(lambda: api.json("GET", "/healthz"))
        return server

    try:
        yield start
    finally:
        for server in started:
            server.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cases", nargs="*", choices=list(CASES), default=list(CASES))
    parser.add_argument("--ways", nargs="*", choices=["tus", "packs"], default=["tus", "packs"])
    parser.add_argument("--folder", type=Path, help="where files and data are made; default the system's temporary folder")
    parser.add_argument("--write", action="store_true", help="into the page")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name, servers(Path(name)) as start:
        loads, lines = [os.getloadavg()[0]], [HEAD, RULE]
        server = start()
        with Api(server.url) as api:
            for case in arguments.cases:
                rounds = [one_round(server, api, Path(name), arguments.ways, *CASES[case]) for _ in range(arguments.rounds)]
                for way in rounds[0]:
                    lines.append(row(case, way, [runs[way] for runs in rounds]))
                    print(lines[-1], flush=True)
                loads.append(os.getloadavg()[0])
    load = f"load average {min(loads):.0f} to {max(loads):.0f}"
    lines = [f"{os.cpu_count()} cores, {load}, {arguments.rounds} rounds.", "", *lines]
    print("\n".join(lines))
    if arguments.write:
        put_between_marks(PAGE, "upload", "\n".join(lines))


if __name__ == "__main__":
    main()
