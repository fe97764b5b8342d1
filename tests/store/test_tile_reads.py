"""A tile costs one statement, found by primary keys on both databases, and one blob, which memory holds up to a bound."""

from pathlib import Path

import pytest
from sqlalchemy import event, text

from wayloom.errors import NotFoundError, WithdrawnError
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, TileEntry, publish
from wayloom.store.tables.maps import MapVersion
from wayloom.store.tile_reads import FoundTile, HeldBlobs, TileReads


def entry(x: int, y: int, digest: str, layer: str = "semantic") -> TileEntry:
    return TileEntry(layer, 18, x, y, digest * 64, "image/png", 1)


@pytest.fixture
def published(database: Database) -> Database:
    """Two versions: one tile is the same in both, one changed, one came, one went."""
    around = [entry(x, y, "f") for x in range(10, 50) for y in range(10, 50)]
    new = NewVersion(0, (8.5, 49.5, 0.0), (), 1, None, [entry(2, 2, "a"), entry(3, 2, "b"), entry(2, 3, "c"), *around])
    with database.write() as session:
        maps.ensure_map(session, "city")
        publish(session, "city", new, kept=5)
        changed = [entry(3, 2, "d"), entry(3, 3, "e")]
        publish(session, "city", NewVersion(1, new.frame, (), 1, None, changed, [("semantic", 18, 2, 3)]), kept=5)
    return database


def digests(found: list[FoundTile]) -> dict[tuple[int, int], str]:
    return {(one.x, one.y): one.digest[0] for one in found}


def test_a_tile_is_that_of_the_version_and_the_newest_by_default(published: Database) -> None:
    reads = TileReads(published)
    assert digests(reads.tiles("city", None, "semantic", 18, 3, 2)) == {(3, 2): "d"}
    assert digests(reads.tiles("city", 1, "semantic", 18, 3, 2)) == {(3, 2): "b"}
    assert digests(reads.tiles("city", 2, "semantic", 18, 2, 2)) == {(2, 2): "a"}
    assert reads.tiles("city", 2, "semantic", 18, 2, 3) == []
    assert reads.tiles("city", 2, "parked", 18, 2, 2) == []
    assert digests(reads.tiles("city", 1, "semantic", 18, 2, 2, size=2)) == {(2, 2): "a", (3, 2): "b", (2, 3): "c"}
    assert digests(reads.tiles("city", 2, "semantic", 18, 2, 2, size=2)) == {(2, 2): "a", (3, 2): "d", (3, 3): "e"}


def test_what_is_not_there_or_withdrawn_is_told_apart(published: Database) -> None:
    reads = TileReads(published)
    with pytest.raises(NotFoundError, match="there is no map 'village'"):
        reads.tiles("village", None, "semantic", 18, 2, 2)
    with pytest.raises(NotFoundError, match="has no version 7"):
        reads.tiles("city", 7, "semantic", 18, 2, 2)
    with published.write() as session:
        maps.ensure_map(session, "empty")
        found = session.get(MapVersion, ("city", 1))
        assert found is not None
        found.withdrawn_at = 1.0
    with pytest.raises(NotFoundError, match="nothing has been published"):
        reads.tiles("empty", None, "semantic", 18, 2, 2)
    with pytest.raises(WithdrawnError, match="version 1"):
        reads.tiles("city", 1, "semantic", 18, 2, 2)


@pytest.mark.parametrize("size", [1, 2])
def test_a_look_up_is_one_statement_that_scans_no_table(published: Database, size: int) -> None:
    reads, said = TileReads(published), []

    @event.listens_for(published.lookups, "before_cursor_execute")
    def note(_connection, _cursor, statement, parameters, _context, _many) -> None:  # type: ignore[no-untyped-def]
        said.append((statement, parameters))

    reads.tiles("city", None, "semantic", 18, 2, 2, size)
    ((statement, parameters),) = said
    with published.lookups.connect() as connection:
        if published.dialect == "sqlite":
            plan = [row[3] for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters)]
            reads_of = [one for one in plan if one.startswith(("SEARCH", "SCAN"))]
            assert len(reads_of) == 3
            assert all(one.startswith("SEARCH") and "INDEX" in one for one in reads_of)
        else:
            connection.execute(text("ANALYZE"))
            connection.execute(text("SET enable_seqscan = off"))  # of two versions it would read both, as it should
            plan = [row[0] for row in connection.exec_driver_sql(f"EXPLAIN {statement}", parameters)]
            connection.execute(text("RESET enable_seqscan"))
            assert not any("Seq Scan" in one for one in plan)
            assert any("using pk_tiles on tiles" in one or "on pk_tiles" in one for one in plan)


@pytest.mark.postgres
def test_a_connection_that_the_server_closed_is_replaced(postgres_database: Database) -> None:
    reads = TileReads(postgres_database)
    with pytest.raises(NotFoundError):
        reads.tiles("city", None, "semantic", 18, 2, 2)
    with postgres_database.engine.begin() as connection:
        others = "pid <> pg_backend_pid() AND datname = current_database()"
        connection.execute(text(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE {others}"))
    with pytest.raises(NotFoundError):
        reads.tiles("city", None, "semantic", 18, 2, 2)


def test_memory_holds_the_blobs_that_were_asked_for_last_up_to_its_bound(tmp_path: Path) -> None:
    blobs = BlobStore(tmp_path)
    names = [blobs.put(bytes([k]) * 40) for k in range(4)]
    held = HeldBlobs(blobs, 100)
    assert [held.get(name)[0] for name in names[:2]] == [0, 1]
    for name in names:
        blobs.delete(name)
    assert [held.get(name)[0] for name in (names[1], names[0])] == [1, 0]  # without the store
    held.made("drawn", lambda: b"x" * 50)  # the longest unused, the second, makes room
    assert held.get(names[0])[0] == 0
    with pytest.raises(NotFoundError):
        held.get(names[1])
    held.made("too large", lambda: b"x" * 101)
    assert held.get(names[0])[0] == 0
    assert HeldBlobs(blobs, 0).made("none is held", lambda: b"y") == b"y"
