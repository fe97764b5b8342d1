"""The audit log in the database: it is added to and read, and the database itself refuses the rest."""

from dataclasses import replace

import pytest
from sqlalchemy import delete, update

from wayloom.store.access.audit import Noted, append, page
from wayloom.store.database import Database, DatabaseError
from wayloom.store.tables.access import AuditEntry

ENTRY = Noted(1.0, "key 0123456789ab", "operator", "POST /v1/drives/{drive_id}/retry", "d" * 64, "10.0.0.1", 200, "done")


def test_entries_are_read_newest_first_page_by_page_and_by_actor_and_outcome(database: Database) -> None:
    with database.write() as session:
        append(session, [replace(ENTRY, at=float(k), outcome="refused" if k % 2 else "done") for k in range(5)])
        append(session, [replace(ENTRY, actor="nobody", object="x\0" + "y" * 999)])
    with database.read() as session:
        first = page(session, 2)
        rest = page(session, 9, before=first[-1].id)
        assert [row.at for row in (*first, *rest)] == [1.0, 4.0, 3.0, 2.0, 1.0, 0.0]
        assert first[0].object == "x" + "y" * 255
        assert len(page(session, 9, actor="nobody")) == 1
        assert [row.at for row in page(session, 9, outcome="refused")] == [3.0, 1.0]


@pytest.mark.parametrize("change", [update(AuditEntry).values(actor="somebody else"), delete(AuditEntry)])
def test_the_database_changes_and_deletes_no_entry(database: Database, change: object) -> None:
    with database.write() as session:
        append(session, [ENTRY])
    with pytest.raises(DatabaseError, match="only ever added to"), database.write() as session:
        session.execute(change)  # type: ignore[call-overload]
    with database.read() as session:
        assert [row.actor for row in page(session, 9)] == [ENTRY.actor]
