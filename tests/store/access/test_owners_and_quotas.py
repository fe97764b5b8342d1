"""Owners of drives, and how much each may send."""

import pytest
from sqlalchemy import update

from wayloom.config.access import DAY_S, AccessSettings
from wayloom.errors import ConflictError, NotFoundError
from wayloom.store import drives, uploads
from wayloom.store.access import owners, quotas
from wayloom.store.access.owners import Owner, owner_of
from wayloom.store.access.quotas import QuotaError
from wayloom.store.database import Database, Session
from wayloom.store.manifest import Manifest
from wayloom.store.tables.drives import Drive

OURS, THEIRS = owner_of("0" * 12, "van-1"), owner_of("1" * 12, None)
SIZE = 100


def register(session: Session, name: str, owner: Owner | None, vehicle_id: str | None = None) -> Drive:
    files = [{"path": "log/a", "size": SIZE, "sha256": "a" * 64}]
    manifest = Manifest.model_validate({"name": name, "files": files, "vehicle_id": vehicle_id})
    return drives.register(session, manifest, "city", owner)[0]


def test_a_drive_belongs_to_the_vehicle_of_the_key_or_to_the_key_whatever_its_manifest_says(database: Database) -> None:
    with database.write() as session:
        ours, theirs, nobodys = register(session, "a", OURS), register(session, "b", THEIRS, "van-1"), register(session, "c", None)
        assert (ours.owner, theirs.owner, nobodys.owner) == ("vehicle van-1", "key 111111111111", None)
        assert (ours.vehicle_id, theirs.vehicle_id, nobodys.vehicle_id) == ("van-1", "van-1", None)
        assert [one.id for one in drives.newest(session, 9, owner=OURS.name)] == [ours.id]
        owners.check_drive(session, ours.id, OURS.name)
        for other in (theirs.id, nobodys.id, "f" * 64, "\0"):
            with pytest.raises(NotFoundError, match="there is no drive"):
                owners.check_drive(session, other, OURS.name)
        upload = uploads.create(session, theirs.id, "log/a", SIZE, "", 60.0)
        session.flush()
        owners.check_upload(session, upload.id, THEIRS.name)
        for name in (upload.id, "f" * 32, "../x", "\0"):
            with pytest.raises(NotFoundError, match="no such upload"):
                owners.check_upload(session, name, OURS.name)


def test_the_manifest_of_anothers_drive_is_refused(database: Database) -> None:
    with database.write() as session:
        first = register(session, "a", OURS)
        assert register(session, "a", OURS) is first
        assert register(session, "a", None) is first
        with pytest.raises(ConflictError, match="announced by another key"):
            register(session, "a", THEIRS)


def test_drives_and_bytes_within_a_day_and_bytes_that_have_not_come_are_counted_by_owner(database: Database) -> None:
    limits = AccessSettings(drives_a_day=3, bytes_a_day=10 * SIZE, open_bytes=10 * SIZE)
    with database.write() as session:
        for name in "ab":
            register(session, name, OURS)
        register(session, "theirs", THEIRS)
        quotas.check_drive(session, OURS.name, SIZE, limits)
        register(session, "c", OURS)
        with pytest.raises(QuotaError, match="3 drives within 24 hours") as refused:
            quotas.check_drive(session, OURS.name, SIZE, limits)
        assert refused.value.after_s == pytest.approx(DAY_S, abs=10.0)
        quotas.check_drive(session, THEIRS.name, SIZE, limits)
        fewer = limits.model_copy(update={"drives_a_day": 99, "bytes_a_day": 4 * SIZE})
        quotas.check_drive(session, OURS.name, SIZE, fewer)
        with pytest.raises(QuotaError, match="400 are allowed"):
            quotas.check_drive(session, OURS.name, SIZE + 1, fewer)
        open_ones = limits.model_copy(update={"drives_a_day": 99, "open_bytes": 4 * SIZE})
        quotas.check_drive(session, OURS.name, SIZE, open_ones)
        with pytest.raises(QuotaError, match="have not come yet"):
            quotas.check_drive(session, OURS.name, SIZE + 1, open_ones)
        drives.mark_complete(session, drives.newest(session, 1, owner=OURS.name)[0].id, "log/a")
        quotas.check_drive(session, OURS.name, SIZE + 1, open_ones)
        session.execute(update(Drive).values(created_at=Drive.created_at - DAY_S))
        quotas.check_drive(session, OURS.name, SIZE, limits)


def test_unfinished_uploads_are_counted_each_though_they_are_of_one_file(database: Database) -> None:
    limits = AccessSettings(open_bytes=3 * SIZE)
    with database.write() as session:
        drive = register(session, "a", OURS)
        for _ in range(3):
            quotas.check_upload(session, OURS.name, SIZE, limits)
            last = uploads.create(session, drive.id, "log/a", SIZE, "", 60.0)
            session.flush()
        with pytest.raises(QuotaError, match="300 bytes have not come yet"):
            quotas.check_upload(session, OURS.name, SIZE, limits)
        uploads.remove(session, last.id)
        quotas.check_upload(session, OURS.name, SIZE, limits)
