"""Drill of cut uploads: each is cut at a random byte in a random way, goes on, and has to arrive whole with little sent twice.

python benchmarks/upload_drills.py [--count 1000] [--seed 0] [--write]

Cuts: `link` (every connection breaks after so many bytes), `client` (the call is left and made again, as by the next process),
`server` (kill -9), `flip` (one bit on the way). Half of the uploads are one file (tus), half are packs. Each sends 1 MB in chunks
of at most 256 KiB. Client and server are cut behind the chunk in which the byte lies: progress is told there.
"""

import argparse
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pages import DOCS, put_between_marks
from service_kit.cut_uploads import Drill, drills

PAGE = DOCS / "benchmarks" / "upload.md"


def table(found: list[Drill]) -> list[str]:
    kinds = defaultdict(list)
    for drill in found:
        kinds[drill.way, drill.cut].append(drill)
    lines = [
        "| way | cut | uploads | all SHA-256 right | cuts | sent beyond the files' bytes, kB a cut: mean | most |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (way, cut), those in sorted(kinds.items()):
        again = [drill.again / drill.cuts / 1e3 for drill in those]
        cuts = sum(drill.cuts for drill in those)
        whole = sum(drill.whole for drill in those)
        lines.append(f"| {way} | {cut} | {len(those)} | {whole} | {cuts} | {sum(again) / len(again):.0f} | {max(again):.0f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="into the page")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        found = drills(arguments.count, arguments.seed, Path(name))
    text = "\n".join([f"{arguments.count} uploads of 1 MB in chunks of at most 256 KiB, seed {arguments.seed}.", "", *table(found)])
    print(text)
    if arguments.write:
        put_between_marks(PAGE, "drills", text)


if __name__ == "__main__":
    main()
