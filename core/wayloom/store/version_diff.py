"""Differences between two versions of a map, page by page, from the rows that versions share: as costly as what has changed.

A row belongs to one of two versions and not to the other where a version between them brought or ended it. An address with such
rows on both sides has changed, unless it has come back to the same bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import ColumnElement, and_, false, or_, select, true, tuple_
from sqlalchemy.orm import Session

from wayloom.store.map_versions import REGION_FEATURES, RegionKey, TileKey
from wayloom.store.maps import Box, of_version
from wayloom.store.tables.maps import RegionRow, TileRow
from wayloom.tiles.grid import MAX_ZOOM, spans_of_box

NOTHING: Final = 0
"""The version before the first: it has no tiles."""
FILES_OF_REGION: Final = ("ground", *REGION_FEATURES)
"""The columns that name files of a region beside its voxels."""
Place = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class TileChange:
    """An address where two versions differ: the digest of what the one has there, and what the other; None where it has nothing."""

    key: TileKey
    before: str | None
    after: TileRow | None


@dataclass(frozen=True, slots=True)
class TileChoice:
    """Which tiles are asked for: layers, sorted, and a box of degrees (None: everywhere)."""

    layers: tuple[str, ...]
    box: Box | None = None

    def condition(self) -> ColumnElement[bool]:
        """Of a tile: it touches the box."""
        if self.box is None:
            return true()
        spans = [(z, span) for z in range(MAX_ZOOM + 1) for span in spans_of_box(self.box, z)]
        return or_(*(and_(TileRow.z == z, TileRow.x.between(w, e), TileRow.y.between(n, s)) for z, (w, e, n, s) in spans), false())


def tile_changes(
    session: Session, map_id: str, versions: tuple[int, int], choice: TileChoice, limit: int, after: TileKey | None = None
) -> tuple[list[TileChange], TileKey | None]:
    """Where the second of two versions differs from the first, by address, from behind `after` on; and where the page ends (None:
    there is no more). The page may hold fewer than `limit`, and none, before the last: addresses that came back are looked at."""
    found: list[TileChange] = []
    looked = 0
    for layer, place in _rest(choice, after):
        here = (TileRow.map_id == map_id, TileRow.layer == layer, choice.condition(), _behind(place))
        first, second = (_tiles_of_one(session, here, *pair, limit - looked) for pair in (versions, versions[::-1]))
        keys = sorted(first.keys() | second.keys())[: limit - looked]
        looked += len(keys)
        for key in keys:
            before, now = first.get(key), second.get(key)
            if before is None or now is None or before.digest != now.digest:
                found.append(TileChange((layer, *key), None if before is None else before.digest, now))
        if looked >= limit:
            return found, (layer, *keys[-1])
    return found, None


def held_changes(
    session: Session,
    map_id: str,
    number: int,
    held: Mapping[TileKey, str],
    choice: TileChoice,
    limit: int,
    after: TileKey | None = None,
) -> tuple[list[TileChange], TileKey | None]:
    """Where a version differs from tiles that somebody holds, by their digests: as `tile_changes`, but as costly as the choice."""
    found: list[TileChange] = []
    looked = 0
    for layer, place in _rest(choice, after):
        here = (TileRow.map_id == map_id, TileRow.layer == layer, choice.condition(), _behind(place), of_version(TileRow, number))
        query = select(TileRow).where(*here).order_by(TileRow.z, TileRow.x, TileRow.y).limit(limit - looked)
        rows = {(row.z, row.x, row.y): row for row in session.scalars(query)}
        looked += len(rows)
        end = max(rows, default=None) if looked >= limit else None
        mine = {key[1:]: digest for key, digest in held.items() if key[0] == layer and (place is None or key[1:] > place)}
        for key in sorted(rows.keys() | {one for one in mine if end is None or one <= end}):
            before, row = mine.get(key), rows.get(key)
            if row is None or before != row.digest:
                found.append(TileChange((layer, *key), before, row))
        if end is not None:
            return found, (layer, *end)
    return found, None


def region_changes(
    session: Session, map_id: str, versions: tuple[int, int], limit: int, after: RegionKey | None = None
) -> tuple[list[tuple[RegionKey, RegionRow | None, RegionRow | None]], RegionKey | None]:
    """The regions that differ, likewise: key, and what either version has there."""
    behind = true() if after is None else tuple_(RegionRow.east, RegionRow.north) > after
    sides = []
    for one, other in (versions, versions[::-1]):
        here = (RegionRow.map_id == map_id, _in_one(RegionRow, one, other), behind)
        rows = session.scalars(select(RegionRow).where(*here).order_by(RegionRow.east, RegionRow.north).limit(limit + 1))
        sides.append({(row.east, row.north): row for row in rows})
    first, second = sides
    keys = sorted(first.keys() | second.keys())
    changed = [(key, first.get(key), second.get(key)) for key in keys[:limit]]
    differing = [one for one in changed if one[1] is None or one[2] is None or _files(one[1]) != _files(one[2])]
    return differing, keys[limit - 1] if len(keys) > limit else None


def _files(row: RegionRow) -> tuple[str, ...]:
    return (row.digest, *(getattr(row, name) for name in FILES_OF_REGION))


def _rest(choice: TileChoice, after: TileKey | None) -> list[tuple[str, Place | None]]:
    """The layers that are left, each with the place behind which it begins."""
    return [
        (layer, after[1:] if after is not None and layer == after[0] else None)
        for layer in sorted(choice.layers)
        if after is None or layer >= after[0]
    ]


def _behind(place: Place | None) -> ColumnElement[bool]:
    return true() if place is None else tuple_(TileRow.z, TileRow.x, TileRow.y) > place


def _tiles_of_one(session: Session, here: Sequence[ColumnElement[bool]], one: int, other: int, limit: int) -> dict[Place, TileRow]:
    """The rows that the one version has and the other has not, by place."""
    if one == NOTHING:
        return {}
    order = [TileRow.z, TileRow.x, TileRow.y]
    query = select(TileRow).where(*here, _in_one(TileRow, one, other))
    if other != NOTHING:  # few rows: found by the versions that brought or ended them, not by walking through all in order
        order[0] = TileRow.z + 0  # type: ignore[call-overload]
        query = query.with_hint(TileRow, f"INDEXED BY ix_tiles_{'since' if one > other else 'until'}", "sqlite")
    return {(row.z, row.x, row.y): row for row in session.scalars(query.order_by(*order).limit(limit + 1))}


def _in_one(table: type[TileRow | RegionRow], one: int, other: int) -> ColumnElement[bool]:
    """Of a row: it belongs to the one version, and not to the other."""
    low, high = sorted((one, other))
    since: Any = table.since
    until: Any = table.until
    if one > other:
        return and_(since > low, since <= high, or_(until.is_(None), until > high))
    return and_(since <= low, until > low, until <= high)
