"""Owners of drives: the vehicle, or the key, that announced them.

An owner is a text: `vehicle ID` of every key that is bound to that vehicle, `key PREFIX` of one that is bound to none. What admins
and operators announce belongs to none of them. A manifest says what it likes; the owner comes from the key alone.
"""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from wayloom.errors import NotFoundError
from wayloom.store.tables.drives import Drive, Upload


@dataclass(frozen=True, slots=True)
class Owner:
    """Who announces drives as a vehicle. vehicle_id: the one that its key is bound to."""

    name: str
    vehicle_id: str | None = None


def owner_of(prefix: str, vehicle_id: str | None) -> Owner:
    """The owner of what a vehicle's key announces."""
    return Owner(f"key {prefix}") if vehicle_id is None else Owner(f"vehicle {vehicle_id}", vehicle_id)


def is_of(session: Session, drive_id: str, owner: str) -> bool:
    """Whether there is a drive of this id and it is the owner's."""
    query = select(Drive.owner).where(Drive.id == drive_id)
    return session.scalars(query).first() == owner if "\0" not in drive_id else False  # PostgreSQL takes no NUL in a text


def check_drive(session: Session, drive_id: str, owner: str) -> None:
    """Raises NotFoundError, as of a drive that there is not, where the drive is not the owner's."""
    if not is_of(session, drive_id, owner):
        raise NotFoundError(f"there is no drive {drive_id[:80]!r}")


def check_upload(session: Session, upload_id: str, owner: str) -> None:
    """Raises NotFoundError, as of an upload that there is not, where its drive is not the owner's."""
    query = select(Drive.owner).join(Upload, Upload.drive_id == Drive.id).where(Upload.id == upload_id)
    found = session.scalars(query).first() if upload_id.isalnum() else None
    if found != owner:
        raise NotFoundError("there is no such upload, or it was dropped")
