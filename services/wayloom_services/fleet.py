"""Endpoints of the fleet page: vehicles, queues, workers, storage; the jobs of a map."""

import shutil
from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Depends, Query

from wayloom import __version__
from wayloom.config.stages import queues as all_queues
from wayloom.store import fleet, maps
from wayloom.store.database import Session
from wayloom.store.etas.intervals import NOMINAL
from wayloom.store.processes import name_of
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.maps import MapId
from wayloom_services.schemas.fleet import (
    EtaCalibrationOut,
    EtaStageOut,
    FleetOut,
    MapJobOut,
    MapJobs,
    QueueOut,
    StorageOut,
    VehicleOut,
    WorkOut,
)

router = APIRouter(prefix="/v1", tags=["service"], dependencies=[Depends(require_key)])


@router.get("/fleet")
async def the_fleet(service: ServiceDep) -> FleetOut:
    """Vehicles with their drives, queues with what waits and runs in them, the jobs that workers hold, and the disk's room."""
    storage = await service.in_thread(lambda: _storage(service))
    return await service.read(lambda session: _fleet(service, session, storage))


@router.get("/maps/{map_id}/jobs", tags=["maps"], responses=PROBLEMS)
async def jobs_of_map(
    map_id: MapId,
    service: ServiceDep,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
    before: Annotated[int | None, Query(ge=1, le=2**53, description="`next` of the page before")] = None,
) -> MapJobs:
    """Every stitch and publish of the map, newest first: when, for how long, what became of it."""

    def read(session: Session) -> MapJobs:
        maps.get(session, map_id)
        rows = fleet.map_jobs(session, map_id, limit, before)
        found = [MapJobOut.model_validate(asdict(row)) for row in rows]
        return MapJobs(jobs=found, next=rows[-1].id if len(rows) == limit else None)

    return await service.read(read)


def _fleet(service: Service, session: Session, storage: StorageOut) -> FleetOut:
    waiting = fleet.queues(session)
    queues = [QueueOut(name=name, **{"queued": 0, "running": 0, **waiting.get(name, {})}) for name in all_queues()]
    work = [WorkOut.model_validate({**asdict(held), "worker": name_of(held.worker)}) for held in fleet.held_jobs(session)]
    vehicles = [VehicleOut.model_validate(asdict(one)) for one in fleet.vehicles(session)]
    judged = service.past.calibration(session)
    calibration = EtaCalibrationOut(
        nominal=NOMINAL, measured=judged.within / judged.judged if judged.judged else None, judged=judged.judged,
        stages=[EtaStageOut(stage=stage, judged=number, within=within) for stage, number, within in service.past.counts(session)],
    )  # fmt: skip
    return FleetOut(
        version=__version__, vehicles=vehicles, queues=queues, work=work, storage=storage,
        retention=str(service.settings.uploads.retention), eta=calibration,
    )  # fmt: skip


def _storage(service: Service) -> StorageOut:
    disk = shutil.disk_usage(service.settings.data_dir)
    return StorageOut(total=disk.total, used=disk.used, free=disk.free, least_free=service.settings.min_free_bytes)
