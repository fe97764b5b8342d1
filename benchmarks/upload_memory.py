"""Memory of the API over many gigabytes of uploads: resident bytes after each, and their slope with its error.

python benchmarks/upload_memory.py [--gigabytes 50] [--minutes M] [--write]

Each gigabyte is a drive of its own: by turns one large file, and 4,000 of 250 kB in packs, over loopback to one API process on
SQLite. A drive's files are deleted when it has arrived: about 3 GB of disk are used at once. The slope is that of the line of least
squares over the second half, when the process has grown to what it needs; its error is one standard error.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pages import put_between_marks
from service_kit.running import ApiAlone
from upload import GIGABYTE, PAGE, memory_mb, send_and_remove, servers
from wayloom.client.api import Api

BLOCK = 10_000_000
SMALL, FILES = 250_000, 4000


def gigabytes(server: ApiAlone, folder: Path, count: int) -> Iterator[tuple[float, float]]:
    """Resident and most resident megabytes of the API after each gigabyte."""
    large, small = folder / "large", folder / "small"
    block = os.urandom(BLOCK)
    with large.open("wb") as file:
        for _ in range(GIGABYTE // BLOCK):
            file.write(block)
    small.write_bytes(os.urandom(SMALL))
    with Api(server.url) as api:
        for number in range(count):
            send_and_remove(server, api, {"log/a": large} if number % 2 == 0 else {f"log/{i:06}": small for i in range(FILES)})
            yield memory_mb(server.process.pid, "VmRSS"), memory_mb(server.process.pid, "VmHWM")


def slope(resident_mb: list[float]) -> tuple[float, float]:
    """Megabytes a gigabyte over the second half, and its standard error. Needs six values."""
    half = np.asarray(resident_mb[len(resident_mb) // 2 :])
    coefficients, covariance = np.polyfit(np.arange(len(half)), half, 1, cov=True)
    return float(coefficients[0]), float(np.sqrt(covariance[0, 0]))


def lines(found: list[tuple[float, float]], seconds: float) -> list[str]:
    resident = [one for one, _ in found]
    by, error = slope(resident)
    shown = [number for number in sorted({1, 2, 5, 10, 20, 30, 40, len(found)}) if number <= len(found)]
    return [
        f"{len(found)} GB in {seconds:.0f} s at a load average of {os.getloadavg()[1]:.1f}. Slope over the second half: "
        f"{by:+.2f} ± {error:.2f} MB a GB.",
        "",
        f"| API's memory, MB: | {' | '.join(f'after {number} GB' for number in shown)} |",
        "| --- |" + " --- |" * len(shown),
        f"| resident | {' | '.join(f'{resident[number - 1]:.0f}' for number in shown)} |",
        f"| most so far | {' | '.join(f'{found[number - 1][1]:.0f}' for number in shown)} |",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=int, default=50, help="at least 12")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="ends when they are over, also with fewer gigabytes")
    parser.add_argument("--folder", type=Path, help="where files and data are made; default the system's temporary folder")
    parser.add_argument("--write", action="store_true", help="into the page")
    arguments = parser.parse_args()
    found, started = [], time.monotonic()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name, servers(Path(name)) as start:
        for one in gigabytes(start(), Path(name), arguments.gigabytes):
            found.append(one)
            took = time.monotonic() - started
            print(f"{len(found)} GB, {took:.0f} s: {one[0]:.1f} MB resident, {one[1]:.1f} MB at most", flush=True)
            if took > 60.0 * arguments.minutes:
                break
    text = "\n".join(lines(found, time.monotonic() - started))
    print(text)
    if arguments.write:
        put_between_marks(PAGE, "memory", text)


if __name__ == "__main__":
    main()
