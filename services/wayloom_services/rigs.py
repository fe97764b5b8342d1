"""Rig endpoints: what is known of each rig, from which drives, since when, and its file."""

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response

from wayloom.calibration.receiver import ReceiverEvidence, receiver_facts
from wayloom.store import rigs
from wayloom.store.database import Session
from wayloom.store.tables.rigs import Rig, RigEvidence, RigVersion
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.errors import Problem
from wayloom_services.schemas.rigs import ReceiverEpochOut, RigDriveOut, RigEpochOut, RigList, RigOut, RigVersionOut

PROBLEMS: dict[int | str, dict[str, Any]] = {404: {"model": Problem}, 401: {"model": Problem}}
RigKey = Annotated[str, Path(pattern="^[0-9a-f]{32}$")]
Number = Annotated[int, Path(ge=1, lt=2**53)]
TOML: dict[int | str, dict[str, Any]] = {200: {"content": {"application/toml": {}}}}
router = APIRouter(prefix="/v1/rigs", tags=["rigs"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("")
async def every(service: ServiceDep) -> RigList:
    """Every rig that a drive has named."""
    return RigList(rigs=await service.read(lambda session: [_rig_out(session, row) for row in rigs.all_rigs(session)]))


@router.get("/{key}")
async def one(key: RigKey, service: ServiceDep) -> RigOut:
    """One rig: its drives, its epochs, the versions of its file with their numbers and sigmas."""
    return await service.read(lambda session: _rig_out(session, rigs.get(session, key)))


@router.get("/{key}/RIG.toml", response_class=Response, responses=TOML)
async def newest_file(key: RigKey, service: ServiceDep) -> Response:
    """The newest version of the rig's file, as `--rig` takes it."""
    return await _file(service, key, None)


@router.get("/{key}/versions/{number}/RIG.toml", response_class=Response, responses=TOML)
async def file_of_version(key: RigKey, number: Number, service: ServiceDep) -> Response:
    """A version of the rig's file: it never changes."""
    return await _file(service, key, number)


async def _file(service: Service, key: str, number: int | None) -> Response:
    version = await service.read(lambda session: rigs.version(session, key, number))
    content = await service.in_thread(lambda: service.blobs.get(version.digest))
    return Response(content, headers={"ETag": f'"{version.digest}"', "Cache-Control": "no-cache"}, media_type="application/toml")


def _rig_out(session: Session, rig: Rig) -> RigOut:
    evidence, versions = rigs.evidence_of(session, rig.id), rigs.versions(session, rig.id)
    starts = sorted({row.from_ns for row in evidence})
    return RigOut(
        id=rig.id, vehicle_id=rig.vehicle_id, rig_id=rig.rig_id, created_at=rig.created_at,
        drives=[_drive_out(row) for row in evidence], epochs=[_epoch_out(evidence, start) for start in starts],
        receivers=[ReceiverEpochOut(**epoch) for epoch in _receivers(evidence)], versions=[_version_out(row) for row in versions],
    )  # fmt: skip


def _receivers(evidence: Sequence[RigEvidence]) -> list[dict[str, Any]]:
    told = [ReceiverEvidence.from_facts(row.drive_id, row.t_ns, row.receiver) for row in evidence if row.receiver is not None]
    return receiver_facts(told)


def _drive_out(row: RigEvidence) -> RigDriveOut:
    scale = row.scale or {}
    return RigDriveOut(
        drive_id=row.drive_id, recorded_at=1e-9 * row.t_ns, epoch_from=1e-9 * row.from_ns,
        gnss_ratio=scale.get("ratio"), gnss_ratio_sigma=scale.get("sigma"),
    )  # fmt: skip


def _epoch_out(evidence: Sequence[RigEvidence], from_ns: int) -> RigEpochOut:
    first = next(row for row in evidence if row.from_ns == from_ns)
    count = sum(row.from_ns == from_ns for row in evidence)
    return RigEpochOut(from_time=1e-9 * from_ns, drives=count, chi_square=first.chi_square, stray=first.stray)


def _version_out(row: RigVersion) -> RigVersionOut:
    return RigVersionOut(
        version=row.version, sha256=row.digest, epoch_from=1e-9 * row.from_ns, drives=row.drives, reason=row.reason,
        facts=row.facts, created_at=row.created_at,
    )  # fmt: skip
