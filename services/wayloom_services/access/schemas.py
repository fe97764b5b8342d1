"""Schemas of sign-ins, keys and the audit log."""

from typing import Annotated

from fastapi import Path
from pydantic import BaseModel, ConfigDict, Field

from wayloom.config.roles import Right, Role
from wayloom.store.tables.access import AccessKey, AuditEntry

Prefix = Annotated[str, Path(pattern="^[0-9a-f]{12}$", description="the public part of a key")]


class Closed(BaseModel):
    """A body in which nothing else may stand."""

    model_config = ConfigDict(extra="forbid")


class SignIn(Closed):
    """Who wants to sign in."""

    name: str = Field(max_length=64)
    password: str = Field(max_length=256)


class Me(BaseModel):
    """Who the server takes the caller for. name: as the audit log has it."""

    name: str
    role: Role
    rights: list[Right]
    signed_in: bool


class KeyIn(Closed):
    """A key that is to be made."""

    name: str = Field(min_length=1, max_length=128, description="what the key is for")
    role: Role
    vehicle_id: str | None = Field(None, min_length=1, max_length=128, description="the vehicle whose drives alone it sends")
    expires_in_s: float | None = Field(None, gt=0, le=10 * 366 * 86400.0, description="seconds from now; none: never")


class RotateIn(Closed):
    """How long the secret before is still taken, seconds; none: as the service's settings say."""

    grace_s: float | None = Field(None, ge=0, le=366 * 86400.0)


class KeyOut(BaseModel):
    """A key without its secret. Times are seconds since 1970."""

    prefix: str
    name: str
    role: Role
    vehicle_id: str | None
    created_at: float
    expires_at: float | None
    used_at: float | None
    rotated_until: float | None
    revoked_at: float | None

    @classmethod
    def of(cls, row: AccessKey) -> "KeyOut":
        """Of a row."""
        return cls(
            prefix=row.prefix, name=row.name, role=Role(row.role), vehicle_id=row.vehicle_id, created_at=row.created_at,
            expires_at=row.expires_at, used_at=row.used_at, rotated_until=row.old_until, revoked_at=row.revoked_at,
        )  # fmt: skip


class NewKey(KeyOut):
    """A key as it is shown this once."""

    key: str


class KeyList(BaseModel):
    """All keys, newest first."""

    keys: list[KeyOut]


class AuditOut(BaseModel):
    """An entry of the audit log: the columns of `AuditEntry`."""

    model_config = ConfigDict(from_attributes=True)

    id: int
    at: float
    actor: str
    role: str | None
    action: str
    object: str
    address: str
    status: int
    outcome: str
    count: int

    @classmethod
    def of(cls, row: AuditEntry) -> "AuditOut":
        """Of a row."""
        return cls.model_validate(row)


class AuditPage(BaseModel):
    """Entries, newest first. next: `before` of the next page, null on the last."""

    entries: list[AuditOut]
    next: int | None
