"""Differences between versions, from the rows that they share: against dictionaries compared the slow way, on both databases."""

import itertools

import numpy as np
import pytest
from sqlalchemy import event, text

from wayloom.store import map_versions, maps, version_diff
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, RegionEntry, TileEntry, TileKey
from wayloom.store.version_diff import TileChange, TileChoice
from wayloom.tiles.formats import SERVED_LAYERS
from wayloom.tiles.grid import TileAddress, tile_bounds

ALL = TileChoice(SERVED_LAYERS)
Tiles = dict[TileKey, str]


def publish(database: Database, before: Tiles, tiles: Tiles, base: int, regions: list[RegionEntry] | None = None) -> None:
    new = [TileEntry(*key, digest, "image/png", 9) for key, digest in tiles.items() if before.get(key) != digest]
    said = NewVersion(base, (8.0, 49.0, 0.0), (), 0, None, new, sorted(before.keys() - tiles.keys()), regions=regions or [])
    with database.write() as session:
        maps.ensure_map(session, "city")
        map_versions.publish(session, "city", said, kept=20)


@pytest.fixture
def history(database: Database) -> list[Tiles]:
    """Version 0, which is nothing, and eight that change, drop, bring and bring back tiles of three layers."""
    rng = np.random.default_rng(7)
    places = [(layer, z, x, 3) for layer in ("points", "semantic", "parked-points") for z in (3, 4) for x in range(8)]
    found: list[Tiles] = [{}]
    for base in range(8):
        tiles = dict(found[-1])
        for _ in range(12):
            key = places[rng.integers(len(places))]
            digest = f"{rng.integers(3):064d}"
            if rng.random() < 0.3:
                tiles.pop(key, None)
            else:
                tiles[key] = digest
        publish(database, found[-1], tiles, base)
        found.append(tiles)
    return found


def expected(before: Tiles, after: Tiles) -> list[tuple[TileKey, str | None, str | None]]:
    keys = sorted(key for key in before.keys() | after.keys() if before.get(key) != after.get(key))
    return [(key, before.get(key), after.get(key)) for key in keys]


def told(found: list[TileChange]) -> list[tuple[TileKey, str | None, str | None]]:
    return [(one.key, one.before, one.after and one.after.digest) for one in found]


@pytest.mark.parametrize("limit", [1, 7, 1000])
def test_any_two_versions_differ_in_what_their_tiles_differ_in_page_by_page(
    database: Database, history: list[Tiles], limit: int
) -> None:
    with database.read() as session:
        for a, b in itertools.permutations(range(len(history)), 2) if limit > 1 else [(0, 8), (8, 2), (3, 7)]:
            found: list[TileChange] = []
            after = None
            for _ in range(200):
                page, after = version_diff.tile_changes(session, "city", (a, b), ALL, limit, after)
                assert len(page) <= limit
                found += page
                if after is None:
                    break
            assert after is None
            assert told(found) == expected(history[a], history[b])


@pytest.mark.parametrize("limit", [1, 5, 1000])
def test_tiles_that_somebody_holds_are_compared_with_a_version(database: Database, history: list[Tiles], limit: int) -> None:
    held = dict(list(history[4].items())[::2]) | {("semantic", 20, 5, 5): "f" * 64, ("height", 20, 5, 5): "f" * 64}
    with database.read() as session:
        for number in (1, 5, 8):
            found: list[TileChange] = []
            after = None
            for _ in range(200):
                page, after = version_diff.held_changes(session, "city", number, held, ALL, limit, after)
                found += page
                if after is None:
                    break
            assert told(found) == expected(held, history[number])


def test_layers_and_a_box_choose_on_both_sides_of_the_antimeridian(database: Database, history: list[Tiles]) -> None:
    def lies_in(key: TileKey, west: float, east: float) -> bool:
        low, _, high, _ = tile_bounds(TileAddress(*key[1:]))
        return any(low <= east + turn and west + turn < high for turn in (0.0, -360.0))

    for west, east in ((-180.0, -100.0), (-50.0, 10.0), (100.0, 200.0), (-180.0, 180.0), (30.0, 30.0)):
        choice = TileChoice(("semantic", "points"), (west, -85.0, east, 85.0))
        with database.read() as session:
            found, _ = version_diff.tile_changes(session, "city", (2, 8), choice, 1000)
        wanted = [one for one in expected(history[2], history[8]) if one[0][0] in choice.layers and lies_in(one[0], west, east)]
        assert told(found) == wanted
    with database.read() as session:
        none, _ = version_diff.tile_changes(session, "city", (0, 8), TileChoice(("semantic",), (-180.0, -85.0, 180.0, -80.0)), 1000)
    assert none == []


def test_what_has_not_changed_is_not_looked_at(database: Database) -> None:
    """Of 6000 tiles three change: the rows are found by the versions that brought and ended them."""
    first = {("semantic", 18, x, 2): "1" * 64 for x in range(6000)}
    publish(database, {}, first, 0)
    second = first | {("semantic", 18, x, 2): "2" * 64 for x in (7, 8)}
    del second["semantic", 18, 9, 2]
    publish(database, first, second, 1)
    sent = []
    with database.write() as session:
        session.execute(text("ANALYZE tiles"))
    with database.read() as session:
        event.listen(session, "do_orm_execute", lambda state: sent.append(state.statement))
        found, _ = version_diff.tile_changes(session, "city", (1, 2), TileChoice(("semantic",)), 5000)
        assert len(found) == 3
        word = "EXPLAIN QUERY PLAN" if database.dialect == "sqlite" else "EXPLAIN"
        for statement in sent[:2]:
            compiled = str(statement.compile(session.get_bind(), compile_kwargs={"literal_binds": True}))
            plan = str(session.execute(text(f"{word} {compiled}")).all())
            assert "ix_tiles_since" in plan or "ix_tiles_until" in plan, plan


def test_regions_differ_by_any_of_their_files(database: Database) -> None:
    def region(east: int, **files: str) -> RegionEntry:
        return RegionEntry(east, -1, "1" * 64, files.pop("digest", "2" * 64), [], 5, **files)

    publish(database, {}, {}, 0, [region(0), region(1), region(2), region(3)])
    publish(database, {}, {}, 1, [region(0, markings="3" * 64), region(1), region(2, digest="4" * 64), region(9)])
    with database.read() as session:
        found, end = version_diff.region_changes(session, "city", (1, 2), 10)
        assert [(key, before is None, now is None) for key, before, now in found] == [
            ((0, -1), False, False), ((2, -1), False, False), ((9, -1), True, False),
        ]  # fmt: skip
        assert end is None
        back, _ = version_diff.region_changes(session, "city", (2, 1), 10)
        assert [key for key, before, now in back if now is None] == [(9, -1)]
        pages, after = [], None
        for _ in range(9):
            page, after = version_diff.region_changes(session, "city", (0, 2), 1, after)
            pages += [key for key, _, _ in page]
            if after is None:
                break
        assert pages == [(0, -1), (1, -1), (2, -1), (3, -1), (9, -1)]
