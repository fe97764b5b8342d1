"""Quotas of owners: drives and bytes within 24 hours, bytes that are announced and have not come."""

from typing import Final

from sqlalchemy import func, select, text
from sqlalchemy.orm import Session

from wayloom.config.access import DAY_S, AccessSettings
from wayloom.errors import WayloomError
from wayloom.store.database import now_s
from wayloom.store.tables.drives import Drive, DriveFile, Upload

ASK_AGAIN_S: Final = 60.0
"""When bytes that are on their way may have come."""


class QuotaError(WayloomError):
    """More than an owner may send. after_s: seconds from now at which it may be tried again."""

    code = "quota-exceeded"

    def __init__(self, what: str, after_s: float) -> None:
        super().__init__(f"{what}; try again in {after_s:.0f} s")
        self.after_s = after_s


def check_drive(session: Session, owner: str, size: int, limits: AccessSettings) -> None:
    """Raises QuotaError where the owner may not announce a drive of so many bytes now. Of two that come at once the second one
    waits for the first: both are counted."""
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(hashtextextended(:owner, 0))"), {"owner": owner})
    now = now_s(session)
    today = select(func.count(), func.coalesce(func.sum(Drive.byte_count), 0), func.min(Drive.created_at))
    count, come, first = session.execute(today.where(Drive.owner == owner, Drive.created_at > now - DAY_S)).one()
    after_s = max(1.0, DAY_S - (now - (first or now)))
    if count + 1 > limits.drives_a_day:
        raise QuotaError(f"{count} drives within 24 hours are announced, {limits.drives_a_day} are allowed", after_s)
    if int(come) + size > limits.bytes_a_day:
        raise QuotaError(f"{size} bytes more than {come} within 24 hours: {limits.bytes_a_day} are allowed", after_s)
    lacking = select(func.coalesce(func.sum(DriveFile.size), 0)).join(Drive, Drive.id == DriveFile.drive_id)
    still = session.scalar(lacking.where(Drive.owner == owner, Drive.state == "uploading", DriveFile.complete.is_(False)))
    _check_open(int(still or 0), size, limits)


def check_upload(session: Session, owner: str, length: int, limits: AccessSettings) -> None:
    """Raises QuotaError where the owner's unfinished uploads, with one more of so many bytes, are too many bytes: of one file
    there may be several."""
    begun = select(func.coalesce(func.sum(Upload.length), 0)).join(Drive, Drive.id == Upload.drive_id)
    still = session.scalar(begun.where(Drive.owner == owner, Upload.complete.is_(False), Upload.expires_at > now_s(session)))
    _check_open(int(still or 0), length, limits)


def _check_open(still: int, more: int, limits: AccessSettings) -> None:
    if still + more > limits.open_bytes:
        raise QuotaError(f"{still} bytes have not come yet, {more} more are too many: {limits.open_bytes} are allowed", ASK_AGAIN_S)
