"""Checks of what belongs to a vehicle, for routes whose path does not name it; and its quotas."""

from fastapi import Request

from wayloom.config.access import AccessSettings
from wayloom.store import drives
from wayloom.store.access import owners, quotas
from wayloom.store.access.owners import Owner
from wayloom.store.database import Session
from wayloom.store.manifest import Manifest
from wayloom_services.access.callers import caller_of
from wayloom_services.access.guard import OBJECT
from wayloom_services.errors import ProtocolError


def owner_of(request: Request) -> Owner | None:
    """Of a vehicle: whose drives alone it sees and sends. None of those that see all."""
    return caller_of(request.scope).owner


def owner_name(request: Request) -> str | None:
    """Its name, for look-ups."""
    owner = owner_of(request)
    return None if owner is None else owner.name


def check_announced(request: Request, session: Session, limits: AccessSettings, manifest: Manifest) -> None:
    """Before a drive is announced. Raises ProtocolError, QuotaError."""
    request.scope[OBJECT] = manifest.drive_id
    owner = owner_of(request)
    if owner is None:
        return
    if owner.vehicle_id is not None and manifest.vehicle_id not in (None, owner.vehicle_id):
        raise ProtocolError(403, "wrong-vehicle", f"this key sends drives of vehicle {owner.vehicle_id} alone")
    if not drives.known(session, [manifest.drive_id]):
        quotas.check_drive(session, owner.name, manifest.byte_count, limits)


def check_upload(request: Request, session: Session, limits: AccessSettings, drive_id: str, length: int) -> None:
    """Before an upload begins that names its drive in a header. Raises NotFoundError, QuotaError."""
    request.scope[OBJECT] = drive_id
    owner = owner_of(request)
    if owner is not None:
        owners.check_drive(session, drive_id, owner.name)
        quotas.check_upload(session, owner.name, length, limits)
