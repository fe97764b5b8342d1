"""Drill of cut uploads: each is cut at a random byte in a random way, goes on, and has to arrive whole with little sent twice.

python benchmarks/upload_drills.py [--count 1000] [--processes 2] [--minutes M] [--seed 0] [--folder DIR] [--write]

Cuts, all within a chunk: `reset` (every connection is reset after so many bytes), `client` (it ends at a byte of a file, and is
started again), `server` (kill -9 when so many bytes have gone to it), `flip` (one bit on the way). Half of the uploads are one file
(tus), half are packs. Each sends 4 MiB in chunks of at most 1 MiB. It ends with an error where a file has not arrived with its
SHA-256, or where more than a chunk was sent again for a cut. `--minutes` ends it early.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pages import DOCS, put_between_marks
from service_kit.cut_uploads import Drill, drills

PAGE = DOCS / "benchmarks" / "upload.md"
TOLD_EVERY = 50


def table(found: list[Drill]) -> list[str]:
    kinds = defaultdict(list)
    for drill in found:
        kinds[drill.way, drill.cut].append(drill)
    lines = [
        "| way | cut | uploads | all SHA-256 right | cuts | bytes of files sent again, kB a cut: mean | most |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (way, cut), those in sorted(kinds.items()):
        again = [drill.again / drill.cuts / 1e3 for drill in those]
        cuts = sum(drill.cuts for drill in those)
        whole = sum(drill.whole for drill in those)
        lines.append(f"| {way} | {cut} | {len(those)} | {whole} | {cuts} | {sum(again) / len(again):.0f} | {max(again):.0f} |")
    return lines


def some(worker: int, count: int, seed: int, minutes: float, folder: Path) -> list[Drill]:
    """The drills of one process, against a server of its own. Raises AssertionError at the first that shows a fault."""
    found, started = [], time.monotonic()
    with tempfile.TemporaryDirectory(dir=folder) as name:
        for drill in drills(count, seed + worker, Path(name)):
            drill.check()
            found.append(drill)
            if len(found) % TOLD_EVERY == 0:
                print(f"process {worker}: {len(found)} in {time.monotonic() - started:.0f} s", flush=True)
            if time.monotonic() - started > 60.0 * minutes:
                break
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=2, help="at once, each with a server of its own")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="ends when they are over, also with fewer uploads")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="where files and data are made")
    parser.add_argument("--write", action="store_true", help="into the page")
    arguments = parser.parse_args()
    started, many = time.monotonic(), arguments.processes
    with ProcessPoolExecutor(many) as pool:
        share = -(-arguments.count // many)
        begun = [pool.submit(some, i, share, arguments.seed, arguments.minutes, arguments.folder) for i in range(many)]
        found = [drill for each in begun for drill in each.result()]
    took = f"{time.monotonic() - started:.0f} s at a load average of {os.getloadavg()[1]:.1f}"
    said = f"{len(found)} uploads of 4 MiB in chunks of at most 1 MiB, seed {arguments.seed}, in `{arguments.folder}`, {took}."
    text = "\n".join([said, "", *table(found)])
    print(text)
    if arguments.write:
        put_between_marks(PAGE, "drills", text)


if __name__ == "__main__":
    main()
