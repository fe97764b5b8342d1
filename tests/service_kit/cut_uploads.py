"""Uploads that are cut at a random byte in a random way, go on, and have to arrive whole with little sent twice."""

import hashlib
import random
from dataclasses import dataclass
from pathlib import Path

from service_kit.links import BadLink
from service_kit.packed_drives import packed_drive_of
from service_kit.running import ApiAlone, until
from wayloom.client.api import Api
from wayloom.client.manifests import PackedDrive
from wayloom.client.upload import upload

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
