"""Uploads that are cut at a random byte in a random way, go on, and have to arrive whole with little sent twice."""

import hashlib
import random
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from service_kit.forked_api import ForkedApi
from service_kit.links import BadLink
from service_kit.packed_drives import packed_drive_of
from service_kit.running import until
from wayloom.client.api import Api
from wayloom.client.manifests import PackedDrive
from wayloom.client.rates import RateLimit
from wayloom.client.upload import upload
from wayloom.errors import ServiceError

SIZE = 4 << 20
CHUNK = 1 << 20
FILES = 40
CUTS = ("reset", "client", "server", "flip")
GIVEN_UP = 3
"""How often a client may end with an error, which a flipped bit in a request's head brings about, and is started again."""


@dataclass(frozen=True)
class Drill:
    """How one upload was cut, and whether every file arrived with its SHA-256.

    again : bytes of files that the client handed to the link beyond those that the files have
    cuts  : how often it was cut
    """

    way: str
    cut: str
    whole: bool
    again: int
    cuts: int

    def check(self) -> None:
        """Raise AssertionError where something is lost, or more than a chunk was sent twice a cut."""
        assert self.whole, self
        assert 0 <= self.again <= self.cuts * CHUNK, self


class CutShortError(Exception):
    """The client ends here."""


class CountedBytes(RateLimit):
    """No limit: counts the bytes of files that are handed to the link, and ends the client at one of them.

    cut_at : the byte before which it ends, once; None: never
    """

    def __init__(self, cut_at: int | None) -> None:
        super().__init__()
        self.sent, self._cut_at = 0, cut_at

    def over(self, blocks: Iterable[memoryview]) -> Iterator[memoryview]:
        for block in blocks:
            if self._cut_at is not None and self.sent + len(block) > self._cut_at:
                rest, self._cut_at = self._cut_at - self.sent, None
                self.sent += rest
                yield block[:rest]
                raise CutShortError
            self.sent += len(block)
            yield block


def one_drill(server: ForkedApi, folder: Path, number: int, rng: random.Random) -> Drill:
    """Send a new drive, cut it, and go on until it has arrived."""
    way, cut = ("tus", "packs")[number % 2], CUTS[number // 2 % len(CUTS)]
    at = rng.randrange(CHUNK // 4, SIZE)
    drive = make_drive(folder / str(number), way, rng)

    def crash() -> None:
        server.kill()
        server.start()

    link = BadLink(
        server.url, break_after=at if cut == "reset" else None, resets=True, flip_at=at if cut == "flip" else None,
        at=at if cut == "server" else None, then=crash,
    )  # fmt: skip
    counted = CountedBytes(at if cut == "client" else None)
    ends = until_it_is_over(lambda: send(link.url, drive, counted, way))
    link.close()
    arrived_whole = arrived(server, drive)
    shutil.rmtree(folder / str(number))
    shutil.rmtree(server.data / "drives" / drive.manifest.drive_id)
    return Drill(way, cut, arrived_whole, counted.sent - drive.manifest.byte_count, max(1, link.broken, ends))


def send(url: str, drive: PackedDrive, counted: CountedBytes, way: str) -> None:
    with Api(url) as api:
        upload(api, drive, connections=1, chunk=CHUNK, limit=counted, packs=way == "packs")


def until_it_is_over(send: Callable[[], None]) -> int:
    """Start the client as often as it takes. Returns how often it ended before all was sent."""
    ends = 0
    while True:
        try:
            send()
        except CutShortError:
            ends += 1
        except ServiceError:
            ends += 1
            if ends > GIVEN_UP:
                raise
        else:
            return ends


def make_drive(folder: Path, way: str, rng: random.Random) -> PackedDrive:
    folder.mkdir(parents=True)
    size, count = (SIZE, 1) if way == "tus" else (SIZE // FILES, FILES)
    return packed_drive_of(folder, folder.name, {f"log/{i:03}": rng.randbytes(size) for i in range(count)})


def arrived(server: ForkedApi, drive: PackedDrive) -> bool:
    folder = server.data / "drives" / drive.manifest.drive_id
    return all(hashlib.sha256((folder / file.path).read_bytes()).hexdigest() == file.sha256 for file in drive.manifest.files)


def drills(count: int, seed: int, folder: Path) -> Iterator[Drill]:
    """So many drills, against one server."""
    rng, server = random.Random(seed), ForkedApi(folder / "data")
    try:
        with Api(server.url) as api:
            until(lambda: api.json("GET", "/healthz"))
        for number in range(count):
            yield one_drill(server, folder / "files", number, rng)
    finally:
        server.close()
