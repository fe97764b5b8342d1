"""Synchronisation of a folder with a map: what has changed travels, and at the end the folder equals one version byte for byte.

Nothing of the folder changes before all that it lacks has come: until then it is the version that it was. A version that is
published meanwhile is not looked at: all that is fetched is of one version, whose tiles never change.
"""

import hashlib
import re
import threading
import time
from collections.abc import Mapping
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wayloom.client.api import AnswerError, Api
from wayloom.client.map_folder import TILE_JSON, Account, MapFolder
from wayloom.config.progress import Progress, silent
from wayloom.errors import InputError, ServiceError
from wayloom.tiles.descriptions import tile_json

CONNECTIONS: Final = 8
ROUNDS: Final = 3
"""How often a version is begun with: one that is withdrawn, or not kept any more, meanwhile is left for the newest."""
GONE: Final = (404, 410)
NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}/\d{1,2}/\d{1,8}/\d{1,8}\.[a-z0-9]{1,8}")
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class SyncChoice:
    """Which part of a map a folder holds: layers (empty: all), a box in degrees (west, south, east, north; None: everywhere)."""

    map_id: str = "city"
    layers: tuple[str, ...] = ()
    bbox: Box | None = None

    def content(self) -> dict[str, Any]:
        """As the manifest has it."""
        return {"map": self.map_id, "only_layers": sorted({*self.layers}), "bbox": None if self.bbox is None else list(self.bbox)}


@dataclass(frozen=True, slots=True)
class SyncOptions:
    """delete strays; read every file instead of trusting size and time stamp; how many files are fetched at once."""

    delete: bool = False
    check: bool = False
    connections: int = CONNECTIONS


@dataclass(frozen=True, slots=True)
class SyncReport:
    """What was done. before: the version that the folder held (None: none); fetched_*: what travelled; strays: files that are not
    of the version, which were left, or deleted where that was asked for."""

    version: int
    before: int | None
    added: int
    replaced: int
    dropped: int
    kept: int
    fetched_files: int
    fetched_bytes: int
    strays: tuple[str, ...]


class _GoneError(Exception):
    """The version that is being fetched is not served any more."""


def sync_map(
    api: Api, root: Path, choice: SyncChoice | None = None, options: SyncOptions | None = None, progress: Progress = silent
) -> SyncReport:
    """Make a folder equal to the newest version of a map. Running it again after any interruption goes on.

    Raises InputError for a folder that holds another map or that another process changes, ServiceError when the server stays away,
    refuses, or sends other bytes than it lists.
    """
    choice, options, folder = choice or SyncChoice(), options or SyncOptions(), MapFolder(root)
    with folder.locked():
        for is_last in (*([False] * (ROUNDS - 1)), True):
            try:
                return _sync(api, folder, choice, options, progress)
            except _GoneError:
                if is_last:
                    raise ServiceError(f"versions of map {choice.map_id!r} went away while they were fetched: try again") from None
    raise AssertionError("the last round either returns or raises")


def _sync(api: Api, folder: MapFolder, choice: SyncChoice, options: SyncOptions, progress: Progress) -> SyncReport:
    account = folder.account()
    if account is not None and account.part["map"] != choice.map_id:
        raise InputError(
            f"holds map {account.part['map']!r}, not {choice.map_id!r}", file=folder.root, remedy="give another folder"
        )
    held = {} if account is None else account.tiles
    version, wanted = _wanted(api, choice, account)
    lies = {path: folder.digest_of(path, None if options.check else held.get(path)) for path in wanted}
    missing = {path: tile.digest for path, tile in wanted.items() if lies[path] != tile.digest}
    fetched = _fetch(api, folder, _Source(choice.map_id, version), {path: wanted[path] for path in missing}, options, progress)
    told = _told(api, choice.map_id, version)
    layers = _layers(told["layers"], wanted)
    ended = [path for path in held if path not in wanted]
    folder.put(missing)
    folder.drop([*ended, *(f"{layer}/{TILE_JSON}" for layer in {path.partition("/")[0] for path in ended} - layers.keys())])
    described = {name: tile_json(name, layer, choice.bbox or told["bounds"], "{z}/{x}/{y}") for name, layer in layers.items()}
    about = {name: told[name] for name in ("created_at", "frame", "bounds")} | {"layers": layers} | _totals(wanted)
    folder.close({path: tile.digest for path, tile in wanted.items()}, version, choice.content(), about, described)
    strays = folder.strays([*wanted, *(f"{layer}/{TILE_JSON}" for layer in layers)])
    if options.delete:
        folder.drop(strays)
    replaced = sum(lies[path] is not None for path in missing)
    before = None if account is None else account.version
    counts = (len(missing) - replaced, replaced, len(ended), len(wanted) - len(missing))
    return SyncReport(version, before, *counts, *fetched, tuple(strays))


@dataclass(frozen=True, slots=True)
class _Tile:
    digest: str
    size: int


@dataclass(frozen=True, slots=True)
class _Source:
    map_id: str
    version: int

    def path(self, name: str) -> str:
        """Where the server has a tile."""
        return f"/v1/maps/{self.map_id}/versions/{self.version}/tiles/{name}"


def _wanted(api: Api, choice: SyncChoice, account: Account | None) -> tuple[int, dict[str, _Tile]]:
    """The newest version and its tiles by path: those of the version that the folder holds, but for what differs. All of them are
    asked for where the folder holds another part, or a version that the server does not know any more."""
    asked: dict[str, Any] = {"version": 0, "bbox": choice.bbox, "layers": sorted({*choice.layers}) or None}
    tiles: dict[str, _Tile] = {}
    if account is not None and account.part == choice.content():
        asked["version"] = account.version
        tiles = {path: _Tile(held.digest, held.size) for path, held in account.tiles.items()}
    while True:
        page = _answered(api, "POST", f"/v1/maps/{choice.map_id}/sync", json=asked)
        if not page["base"] and "after" not in asked:
            tiles, asked["version"] = {}, 0
        for tile in (*page["add"], *page["replace"]):
            tiles[_checked(tile["name"])] = _Tile(str(tile["digest"]), int(tile["bytes"]))
        for tile in page["drop"]:
            tiles.pop(tile["name"], None)
        if page["next"] is None:
            return page["version"], tiles
        asked |= {"to": page["version"], "after": page["next"]}


def _checked(name: str) -> str:
    """The name of a tile, which is a path below the folder. Raises ServiceError for another: no server writes where it likes."""
    if not NAME.fullmatch(name):
        raise ServiceError(f"the server names a tile {name[:80]!r}, which is no layer/z/x/y.ext")
    return name


def _answered(api: Api, method: str, path: str, **request: Any) -> dict[str, Any]:
    """The answer's JSON. Raises _GoneError where a version that is asked for is gone."""
    try:
        found: dict[str, Any] = api.json(method, path, **request)
    except AnswerError as error:
        if error.status in GONE and (request.get("json") or {}).get("to", "versions" in path):
            raise _GoneError from None
        raise
    return found


def _told(api: Api, map_id: str, version: int) -> dict[str, Any]:
    return _answered(api, "GET", f"/v1/maps/{map_id}/versions/{version}")


def _fetch(
    api: Api, folder: MapFolder, source: _Source, missing: Mapping[str, _Tile], options: SyncOptions, progress: Progress
) -> tuple[int, int]:
    """Have the bytes of the tiles come into the folder, each once, unless they have come before. How many files, and bytes."""
    by_digest = {tile.digest: (path, tile.size) for path, tile in sorted(missing.items(), reverse=True)}
    left = {digest: one for digest, one in by_digest.items() if not folder.has_come(digest)}
    meter, over = _Meter(sum(size for _, size in left.values()), progress), threading.Event()

    def one(digest: str, path: str) -> None:
        if not over.is_set():
            content = _content(api, source.path(path), digest)
            folder.take(digest, content)
            meter.add(len(content))

    with ThreadPoolExecutor(options.connections) as pool:
        futures = [pool.submit(one, digest, path) for digest, (path, _) in sorted(left.items(), key=lambda item: item[1])]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            over.set()
            pool.shutdown(cancel_futures=True)
    for future in futures:
        if not future.cancelled() and (error := future.exception()) is not None:
            raise error
    meter.end()
    return len(left), meter.bytes


def _content(api: Api, path: str, digest: str) -> bytes:
    """A tile's bytes, twice where they are damaged on the way. Raises _GoneError, ServiceError."""
    for _ in range(2):
        try:
            content = api.content(path)
        except AnswerError as error:
            if error.status in GONE:
                raise _GoneError from None
            raise
        if hashlib.sha256(content).hexdigest() == digest:
            return content
    raise ServiceError(f"{path} has other bytes than the server lists (SHA-256 {digest[:12]}…)")


class _Meter:
    """Bytes that have come, counted from several threads, and how fast they come."""

    def __init__(self, total: int, progress: Progress) -> None:
        self.bytes, self._total, self._progress = 0, total, progress
        self._began, self._lock = time.monotonic(), threading.Lock()

    def add(self, count: int) -> None:
        """So many more have come."""
        with self._lock:
            self.bytes += count
            if self.bytes < self._total:
                self._tell(self.bytes / self._total)

    def end(self) -> None:
        """All have."""
        self._tell(1.0)

    def _tell(self, share: float) -> None:
        speed = self.bytes / max(time.monotonic() - self._began, 1e-3)
        self._progress(share, f"{self.bytes / 1e6:.1f} of {self._total / 1e6:.1f} MB, {speed / 1e6:.1f} MB/s")


def _layers(told: Mapping[str, Mapping[str, Any]], wanted: Mapping[str, _Tile]) -> dict[str, dict[str, Any]]:
    """The layers of the tiles, as `MapVersion.layers` but counted of these."""
    zooms: dict[str, dict[int, int]] = {}
    for path in wanted:
        layer, z = path.split("/")[:2]
        by_zoom = zooms.setdefault(layer, {})
        by_zoom[int(z)] = by_zoom.get(int(z), 0) + 1
    return {
        layer: {
            "min_zoom": min(by_zoom), "max_zoom": max(by_zoom), "media_type": told[layer]["media_type"],
            "tiles": sum(by_zoom.values()), "zooms": {str(z): count for z, count in sorted(by_zoom.items())},
        }
        for layer, by_zoom in sorted(zooms.items())
    }  # fmt: skip


def _totals(wanted: Mapping[str, _Tile]) -> dict[str, int]:
    return {"tiles": len(wanted), "bytes": sum(tile.size for tile in wanted.values())}
