"""Drill of cut uploads: each is cut at a random byte in a random way, goes on, and has to arrive whole with little sent twice.

python benchmarks/upload_drills.py [--count 1000] [--seed 0] [--write]

Cuts: `link` (every connection breaks after so many bytes), `client` (the call is left and made again, as by the next process),
`server` (kill -9), `flip` (one bit on the way). Half of the uploads are one file (tus), half are packs. Each sends 1 MB in chunks
of at most 256 KiB. Client and server are cut behind the chunk in which the byte lies: progress is told there.
"""

import argparse
import hashlib
import random
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pages import put_between_marks
from service_kit.links import BadLink
from service_kit.packed_drives import packed_drive_of
from service_kit.running import ApiAlone, until
from wayloom.client.api import Api
from wayloom.client.manifests import PackedDrive
from wayloom.client.upload import upload

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "upload.md"
SIZE = 1 << 20
CHUNK = 256 << 10
FILES = 40
CUTS = ("link", "client", "server", "flip")
OVERHEAD = 64 << 10
"""Bytes of heads, manifests and lists that a client sends beside the files'."""


@dataclass(frozen=True)
class Drill:
    """How one upload was cut, whether every file arrived with its SHA-256, and how many bytes were sent beyond the files'.

    cuts : how often it was cut
    """

    way: str
    cut: str
    whole: bool
    again: int
    cuts: int


class CutShortError(Exception):
    """The client ends here."""


def one_drill(server: ApiAlone, folder: Path, number: int, rng: random.Random) -> Drill:
    """Send a new drive, cut it, and go on until it has arrived."""
    way, cut = ("tus", "packs")[number % 2], CUTS[number // 2 % len(CUTS)]
    at = rng.randrange(CHUNK // 4, SIZE)
    drive = make_drive(folder / str(number), way, rng)
    link = BadLink(server.url, break_after=at if cut == "link" else None, flip_at=at if cut == "flip" else None)

    def told(share: float, _what: str, /) -> None:
        nonlocal at
        if cut in ("client", "server") and at and share * SIZE >= at:
            at = 0
            if cut == "client":
                raise CutShortError
            server.kill()
            server.start()

    with Api(link.url) as api:
        while True:
            try:
                upload(api, drive, told, connections=1, chunk=CHUNK, packs=way == "packs")
                break
            except CutShortError:
                continue
    link.close()
    return Drill(way, cut, arrived(server, drive), link.sent - drive.manifest.byte_count, max(1, link.broken))


def make_drive(folder: Path, way: str, rng: random.Random) -> PackedDrive:
    folder.mkdir(parents=True)
    size, count = (SIZE, 1) if way == "tus" else (SIZE // FILES, FILES)
    return packed_drive_of(folder, folder.name, {f"log/{i:03}": rng.randbytes(size) for i in range(count)})


def arrived(server: ApiAlone, drive: PackedDrive) -> bool:
    folder = server.data / "drives" / drive.manifest.drive_id
    return all(hashlib.sha256((folder / file.path).read_bytes()).hexdigest() == file.sha256 for file in drive.manifest.files)


def drills(count: int, seed: int, folder: Path) -> list[Drill]:
    """So many drills, against one server."""
    rng, server = random.Random(seed), ApiAlone(folder / "data")
    try:
        with Api(server.url) as api:
            until(lambda: api.json("GET", "/healthz"))
        return [one_drill(server, folder / "files", number, rng) for number in range(count)]
    finally:
        server.close()


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
