"""Reads of tiles for the server: one statement by primary keys, and one blob, held in memory where it is asked for often."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final

from sqlalchemy import BindParameter, Row, Select, and_, bindparam, func, or_, select
from sqlalchemy.exc import DBAPIError

from wayloom.errors import NotFoundError
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.maps import nothing_published, withdrawn_version
from wayloom.store.tables.maps import Map, MapVersion, TileRow

LARGEST_HELD: Final = 2**20
"""Bytes of a blob that is kept in memory."""


@dataclass(frozen=True, slots=True)
class FoundTile:
    """A tile of a version: its column and row, its blob's digest, its media type."""

    x: int
    y: int
    digest: str
    media_type: str


class TileReads:
    """Looks up tiles of versions. Safe to share between threads."""

    def __init__(self, database: Database) -> None:
        self._engine = database.lookups
        self._statements = {size: _statement(size) for size in (1, 2)}

    def tiles(self, map_id: str, number: int | None, layer: str, z: int, x: int, y: int, size: int = 1) -> list[FoundTile]:
        """Of a version, the newest by default, the size x size tiles whose first is x, y; those that are there.

        Raises NotFoundError where there is no such map or version, WithdrawnError where it is withdrawn.
        """
        asked: dict[str, str | int | None] = {"map": map_id, "number": number, "layer": layer, "z": z}
        rows = self._execute(
            self._statements[size], asked | {f"{name}{k}": v + k for name, v in (("x", x), ("y", y)) for k in range(size)}
        )
        if not rows:
            raise NotFoundError(f"there is no map {map_id[:80]!r}")
        if rows[0].version is None:
            raise nothing_published(map_id, number)
        if rows[0].withdrawn_at is not None:
            raise withdrawn_version(map_id, rows[0].version)
        return [FoundTile(row.x, row.y, row.digest, row.media_type) for row in rows if row.digest is not None]

    def _execute(self, statement: Select[*tuple[Any, ...]], asked: dict[str, str | int | None]) -> list[Row[Any]]:
        for attempt in (1, 2):
            try:
                with self._engine.connect() as connection:
                    return list(connection.execute(statement, asked).all())
            except DBAPIError as error:  # the server closed a connection that waited in the pool: all of them are replaced
                if attempt == 2 or not error.connection_invalidated:
                    raise
        raise AssertionError("two attempts end by a result or an error")


def _statement(size: int) -> Select[*tuple[Any, ...]]:
    """The map's row, its version's, and the tiles': each by its primary key."""
    of_version = and_(MapVersion.map_id == bindparam("map"), MapVersion.version == func.coalesce(bindparam("number"), Map.version))
    x: list[BindParameter[int]] = [bindparam(f"x{k}") for k in range(size)]
    y: list[BindParameter[int]] = [bindparam(f"y{k}") for k in range(size)]
    at = (TileRow.x.in_(x), TileRow.y.in_(y)) if size > 1 else (TileRow.x == x[0], TileRow.y == y[0])
    place = (TileRow.map_id == bindparam("map"), TileRow.layer == bindparam("layer"), TileRow.z == bindparam("z"), *at)
    lasts = or_(TileRow.until.is_(None), TileRow.until > MapVersion.version)
    here = and_(*place, TileRow.since <= MapVersion.version, lasts)
    columns = (MapVersion.version, MapVersion.withdrawn_at, TileRow.x, TileRow.y, TileRow.digest, TileRow.media_type)
    joined = Map.__table__.outerjoin(MapVersion, of_version).outerjoin(TileRow, here)
    return select(*columns).select_from(joined).where(Map.id == bindparam("map"))


class HeldBlobs:
    """Blobs that were asked for last, up to a number of bytes. Safe to share between threads."""

    def __init__(self, blobs: BlobStore, most_bytes: int) -> None:
        self._blobs, self._most = blobs, most_bytes
        self._held: OrderedDict[str, bytes] = OrderedDict()
        self._bytes, self._lock = 0, Lock()

    def get(self, digest: str) -> bytes:
        """The bytes of a blob. Raises NotFoundError."""
        return self.made(digest, lambda: self._blobs.get(digest))

    def made(self, name: str, make: Callable[[], bytes]) -> bytes:
        """What is held under a name, made where it is not; equal names are equal bytes."""
        with self._lock:
            held = self._held.get(name)
            if held is not None:
                self._held.move_to_end(name)
                return held
        content = make()
        if len(content) <= min(LARGEST_HELD, self._most):
            self._hold(name, content)
        return content

    def _hold(self, name: str, content: bytes) -> None:
        with self._lock:
            if name not in self._held:
                self._held[name] = content
                self._bytes += len(content)
            while self._bytes > self._most:
                self._bytes -= len(self._held.popitem(last=False)[1])
