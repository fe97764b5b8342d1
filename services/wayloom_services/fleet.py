"""Endpoint of the fleet page: vehicles, queues, workers, storage."""

import shutil
from dataclasses import asdict

from fastapi import APIRouter, Depends

from wayloom import __version__
from wayloom.config.stages import queues as all_queues
from wayloom.store import fleet
from wayloom.store.database import Session
from wayloom.store.etas import told
from wayloom.store.etas.intervals import NOMINAL
from wayloom.store.processes import name_of
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.schemas.fleet import EtaCalibrationOut, EtaStageOut, FleetOut, QueueOut, StorageOut, VehicleOut, WorkOut

router = APIRouter(prefix="/v1", tags=["service"], dependencies=[Depends(require_key)])


@router.get("/fleet")
async def the_fleet(service: ServiceDep) -> FleetOut:
    """Vehicles with their drives, queues with what waits and runs in them, the jobs that workers hold, and the disk's room."""
    storage = await service.in_thread(lambda: _storage(service))
    return await service.read(lambda session: _fleet(service, session, storage))


def _fleet(service: Service, session: Session, storage: StorageOut) -> FleetOut:
    waiting = fleet.queues(session)
    queues = [QueueOut(name=name, **{"queued": 0, "running": 0, **waiting.get(name, {})}) for name in all_queues()]
    work = [WorkOut.model_validate({**asdict(held), "worker": name_of(held.worker)}) for held in fleet.held_jobs(session)]
    vehicles = [VehicleOut.model_validate(asdict(one)) for one in fleet.vehicles(session)]
    judged = told.calibration(session)
    calibration = EtaCalibrationOut(
        nominal=NOMINAL, measured=judged.within / judged.judged if judged.judged else None, judged=judged.judged,
        stages=[EtaStageOut(stage=stage, judged=number, within=within) for stage, number, within in told.counts(session)],
    )  # fmt: skip
    return FleetOut(
        version=__version__, vehicles=vehicles, queues=queues, work=work, storage=storage,
        retention=str(service.settings.uploads.retention), eta=calibration,
    )  # fmt: skip


def _storage(service: Service) -> StorageOut:
    disk = shutil.disk_usage(service.settings.data_dir)
    return StorageOut(total=disk.total, used=disk.used, free=disk.free, least_free=service.settings.min_free_bytes)
