"""Endpoints of admins: keys, and the audit log."""

from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request

from wayloom.config.roles import Role
from wayloom.store.access import audit, keys
from wayloom.store.database import Session
from wayloom.store.tables.access import AccessKey
from wayloom_services.access.guard import OBJECT
from wayloom_services.access.schemas import AuditOut, AuditPage, KeyIn, KeyList, KeyOut, NewKey, Prefix, RotateIn
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.errors import Problem, ProtocolError

OF_ONE_KEY: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (404, 409)}
AS_SET = RotateIn(grace_s=None)
router = APIRouter(prefix="/v1", tags=["access"], dependencies=[Depends(require_key)])


@router.get("/keys")
async def all_keys(service: ServiceDep) -> KeyList:
    """Every key, those that are revoked too; no secrets, which nobody has but their owners."""
    return KeyList(keys=await service.read(lambda session: [KeyOut.of(row) for row in keys.every(session)]))


@router.post("/keys", status_code=201)
async def create_key(wanted: KeyIn, request: Request, service: ServiceDep) -> NewKey:
    """Make a key. Its text is in this answer and nowhere else."""
    if wanted.vehicle_id is not None and wanted.role is not Role.VEHICLE:
        raise ProtocolError(400, "bad-request", f"a key of the role {wanted.role} is not bound to a vehicle")
    made = await _changed(
        service, lambda session: keys.create(session, wanted.name, wanted.role, wanted.vehicle_id, wanted.expires_in_s)
    )
    request.scope[OBJECT] = f"key {made.prefix}"
    return made


@router.post("/keys/{prefix}/rotate", responses=OF_ONE_KEY)
async def rotate_key(prefix: Prefix, service: ServiceDep, wanted: RotateIn = AS_SET) -> NewKey:
    """Give the key a new secret. The one before is taken for a while, so that a vehicle has time to get the new one."""
    grace_s = service.settings.access.rotation_grace_s if wanted.grace_s is None else wanted.grace_s
    return await _changed(service, lambda session: keys.rotate(session, prefix, grace_s))


@router.delete("/keys/{prefix}", responses=OF_ONE_KEY)
async def revoke_key(prefix: Prefix, service: ServiceDep) -> KeyOut:
    """Revoke the key: this process refuses it from now on, others of the same service within `access.held_s` seconds."""
    found = await service.write(lambda session: KeyOut.of(keys.revoke(session, prefix)))
    service.callers.forget()
    return found


@router.get("/audit")
async def audit_log(
    service: ServiceDep,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    before: Annotated[int | None, Query(ge=1, le=2**53, description="`next` of the page before")] = None,
    actor: Annotated[str | None, Query(max_length=160, description="of this one alone, as `key 0123456789ab`")] = None,
    outcome: Literal["done", "refused", "failed"] | None = None,
) -> AuditPage:
    """Changes and refusals, newest first."""
    rows = await service.read(lambda session: audit.page(session, limit, before, actor, outcome))
    return AuditPage(entries=[AuditOut.of(row) for row in rows], next=rows[-1].id if len(rows) == limit else None)


async def _changed(service: Service, change: Callable[[Session], tuple[AccessKey, str]]) -> NewKey:
    def made(session: Session) -> NewKey:
        row, text = change(session)
        return NewKey(**KeyOut.of(row).model_dump(), key=text)

    found = await service.write(made)
    service.callers.forget()
    return found
