"""Health, readiness and metrics endpoints."""

from fastapi import APIRouter, Depends, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST
from redis import Redis
from redis.exceptions import RedisError

from wayloom import __version__
from wayloom.config.classes import CLASS_NAMES, MOVING_CLASSES, PALETTE, SKY
from wayloom.config.stages import drive_stages, map_stages
from wayloom.segmentation.catalogue import MODELS
from wayloom.stitching.layer_names import OVERLAYS
from wayloom.store import counts, migrate
from wayloom.store.blobs import BlobError
from wayloom.store.database import DatabaseError, Session
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.schemas.about import ClassOut, Health, Info

router = APIRouter(tags=["service"])


@router.get("/healthz")
async def alive() -> Health:
    """Liveness: the process answers."""
    return Health(status="ok", version=__version__, checks={})


@router.get("/readyz", responses={503: {"model": Health}})
async def ready(response: Response, service: ServiceDep) -> Health:
    """Readiness: the object store is there, the database too and up to date. Without a broker drives
    still arrive and wait: `degraded`, but 200."""
    checks = {
        "database": await service.in_thread(lambda: _database(service)),
        "objects": await service.in_thread(lambda: _objects(service)),
        "broker": await service.in_thread(lambda: _broker(service)),
    }
    response.status_code = 200 if checks["database"] == checks["objects"] == "ok" else 503
    return Health(status="ok" if set(checks.values()) == {"ok"} else "degraded", version=__version__, checks=checks)


@router.get("/metrics", response_class=PlainTextResponse, dependencies=[Depends(require_key)])
async def metrics(service: ServiceDep) -> Response:
    """In Prometheus' text format."""
    await service.read(lambda session: _count(service, session))
    return Response(await service.in_thread(service.metrics.exposition), media_type=CONTENT_TYPE_LATEST)


@router.get("/v1/info")
async def info(service: ServiceDep) -> Info:
    """The map, the stages and the classes; needs no key."""
    classes = [
        ClassOut(id=i, name=name, colour=f"#{PALETTE[i].tobytes().hex()}", in_map=i not in (*MOVING_CLASSES, SKY))
        for i, name in enumerate(CLASS_NAMES)
    ]
    settings = service.settings
    return Info(
        version=__version__,
        map_id=settings.map_id,
        needs_key=settings.is_closed,
        oidc_label=None if service.oidc is None else settings.access.oidc_label,
        stages=[*drive_stages(), *map_stages()],
        overlays=[*OVERLAYS],
        classes=classes,
        models=sorted(MODELS),
    )


def _database(service: Service) -> str:
    try:
        return (
            "ok"
            if migrate.is_current(service.database)
            else "migrations are missing: run `wayloom up` or `python -m wayloom.store`"
        )
    except DatabaseError as error:
        return type(error).__name__


def _objects(service: Service) -> str:
    try:
        service.blobs.has("0" * 64)
        service.uploads.check()
    except BlobError as error:
        return type(error).__name__
    return "ok"


def _broker(service: Service) -> str:
    url = service.settings.broker.replace("redis+socket://", "unix://")
    try:
        with Redis.from_url(url, socket_connect_timeout=2, socket_timeout=2) as client:
            client.ping()
    except RedisError as error:
        return type(error).__name__
    return "ok"


def _count(service: Service, session: Session) -> None:
    service.metrics.jobs.clear()
    for stage, state, number in counts.jobs(session):
        service.metrics.jobs.labels(stage, state).set(number)
    service.metrics.drives.clear()
    for state, number in counts.drives(session):
        service.metrics.drives.labels(state).set(number)
    service.metrics.estimates.counts = {stage: (judged, within) for stage, judged, within in service.past.counts(session)}
    for map_id, version in counts.maps(session):
        service.metrics.map_version.labels(map_id).set(version)
