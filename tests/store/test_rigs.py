"""Rigs: evidence and versions are written as one, or not at all."""

import pytest

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store import drives, rigs
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.rigs import ByGnss, Evidence, EvidenceEpoch, NewRigVersion


def drive(database: Database, name: str) -> str:
    with database.write() as session:
        manifest = Manifest(name=name, vehicle_id="taxi", files=(ManifestFile(path="log/0", size=1, sha256="0" * 64),))
        return drives.register(session, manifest, "city")[0].id


def the_rig(database: Database) -> str:
    with database.write() as session:
        return rigs.ensure(session, "taxi", "roof").id


def version(from_ns: int, *of: str, digest: str = "a" * 64) -> NewRigVersion:
    return NewRigVersion(from_ns, "e" * 64, digest, of, "evidence changed", {"matches": 5})


def evidence(drive_id: str, t_ns: int) -> Evidence:
    return Evidence(drive_id, "b" * 64, "c" * 64, t_ns)


def epoch(from_ns: int, chi_square: float | None = None, stray: bool = False) -> EvidenceEpoch:
    return EvidenceEpoch(from_ns, chi_square, stray)


def test_a_rig_is_of_its_vehicle_and_its_name() -> None:
    keys = {rigs.rig_key("taxi", "roof"), rigs.rig_key("taxi", None), rigs.rig_key(None, "roof"), rigs.rig_key("bus", "roof")}
    assert len(keys) == 4
    assert rigs.rig_key(None, None) is None


def test_the_same_names_are_the_same_rig_and_none_is_refused(database: Database) -> None:
    assert the_rig(database) == the_rig(database)
    with pytest.raises(ConflictError), database.write() as session:
        rigs.ensure(session, None, None)
    with pytest.raises(NotFoundError), database.read() as session:
        rigs.get(session, "0" * 32)


def test_evidence_and_versions_are_written_as_one(database: Database) -> None:
    key, one, other = the_rig(database), drive(database, "one"), drive(database, "other")
    with database.write() as session:
        assert rigs.write(session, key, 0, {one: epoch(10)}, [version(10, one)], [evidence(one, 10)])
    with database.write() as session:
        epochs = {one: epoch(10), other: epoch(20, 99.0)}
        assert rigs.write(
            session, key, 1, epochs, [version(20, other)], [evidence(other, 20)], {one: ByGnss({"ratio": 1.01}, {"pull": [1.0]})}
        )
    with database.read() as session:
        rows = rigs.evidence_of(session, key)
        assert [(row.drive_id, row.from_ns, row.chi_square) for row in rows] == [(one, 10, None), (other, 20, 99.0)]
        assert [row.scale for row in rows] == [{"ratio": 1.01}, None]
        assert [row.receiver for row in rows] == [{"pull": [1.0]}, None]
        assert [row.version for row in rigs.versions(session, key)] == [2, 1]
        assert rigs.version(session, key).drives == [other]
        assert rigs.version(session, key, 1).drives == [one]


def test_what_was_learnt_from_an_older_state_is_not_written(database: Database) -> None:
    key, one, other = the_rig(database), drive(database, "one"), drive(database, "other")
    with database.write() as session:
        assert rigs.write(session, key, 0, {one: epoch(10)}, [version(10, one)], [evidence(one, 10)])
    with database.write() as session:
        assert not rigs.write(session, key, 0, {other: epoch(5)}, [version(5, other)], [evidence(other, 5)])
    with database.read() as session:
        assert [row.drive_id for row in rigs.evidence_of(session, key)] == [one]
        assert len(rigs.versions(session, key)) == 1


def test_a_drive_gets_the_newest_version_of_the_epoch_in_which_it_was_recorded(database: Database) -> None:
    key, one, two, stray = the_rig(database), drive(database, "one"), drive(database, "two"), drive(database, "stray")
    with database.read() as session:
        assert rigs.version_for(session, key, 10) is None
    epochs = {one: epoch(10), stray: epoch(15, 80.0, True), two: epoch(20, 99.0)}
    new = [version(10, one), version(20, two), version(10, one, digest="d" * 64)]
    with database.write() as session:
        rigs.write(session, key, 0, epochs, new, [evidence(one, 10), evidence(stray, 15), evidence(two, 20)])
    with database.read() as session:
        chosen = [rigs.version_for(session, key, t_ns) for t_ns in (5, 10, 16, 20, 99)]
        assert [found.version if found else None for found in chosen] == [3, 3, 3, 2, 2]


def test_evidence_goes_with_its_drive_and_so_do_the_versions_that_were_learnt_from_it(database: Database) -> None:
    key, one, two = the_rig(database), drive(database, "one"), drive(database, "two")
    with database.write() as session:
        epochs = {one: epoch(10), two: epoch(10)}
        rigs.write(session, key, 0, epochs, [version(10, one, two)], [evidence(one, 10), evidence(two, 11)])
    with database.write() as session:
        drives.request_removal(session, one)
    with database.read() as session:
        assert [row.drive_id for row in rigs.evidence_of(session, key)] == [two]
    with database.write() as session:
        drives.delete_rows(session, one)
    with database.read() as session:
        assert rigs.evidence_of_drive(session, one) is None
        assert rigs.versions(session, key) == []
