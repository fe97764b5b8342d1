"""Drive endpoints: registration, listing, state, track, preview, retry, removal."""

import json
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from fastapi.responses import StreamingResponse

from wayloom.errors import ConflictError
from wayloom.geodesy.antimeridian import line_geometry
from wayloom.store import drive_search, drives, gate, jobs, packs, reprocessing, rigs, runs, uploads
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.manifest import Manifest
from wayloom.store.manifest_text import parse_manifest
from wayloom.store.tables.drives import Drive, Upload
from wayloom_services.access import own
from wayloom_services.collector import paused_collector
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.errors import Problem, ProtocolError
from wayloom_services.schemas.drives import (
    DriveList,
    DriveOut,
    DriveQuery,
    MissingFile,
    OpenPack,
    Registration,
    ReleaseIn,
    ReprocessIn,
    RetryIn,
)
from wayloom_services.schemas.inlining import inlined_schema
from wayloom_services.schemas.lineage import RunList
from wayloom_services.schemas.maps import Feature
from wayloom_services.views import drives_out, run_detail

PROBLEMS: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (400, 401, 404, 408, 409, 422)}
NOTHING_ELSE: Final = ReprocessIn()
GO_ON: Final = RetryIn(stage=None)
DriveId = Annotated[str, Path(pattern="^[0-9a-f]{64}$")]
router = APIRouter(prefix="/v1/drives", tags=["drives"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.post(
    "",
    status_code=201,
    response_model=Registration,
    responses={200: {"model": Registration}, 413: {"model": Problem}},
    openapi_extra={"requestBody": {"required": True, "content": {"application/json": {"schema": inlined_schema(Manifest)}}}},
)
async def register(
    request: Request,
    service: ServiceDep,
    again: Annotated[bool, Query(description="where the images of the drive were deleted, have them sent once more")] = False,
) -> Response:
    """Announce a drive. The same manifest again is the same drive: 200, with the files that are still missing. Of a drive whose
    images were deleted none is missing, unless `again` asks for them."""
    content = await request.body()
    with paused_collector():
        answer, first_job = await _announce(service, request, content, again)
    await service.notify(first_job)
    headers = {"Location": f"/v1/drives/{answer.id}"}
    body = _registration(service, answer)
    return StreamingResponse(body, 201 if answer.created else 200, headers, media_type="application/json")


async def _announce(service: Service, request: Request, content: bytes, again: bool) -> tuple[Registration, JobMessage | None]:
    """The registration of a manifest, and the drive's first job where nothing is missing."""
    manifest = await service.in_thread(lambda: parse_manifest(content, service.settings.max_drive_files))
    _check_size(service, manifest)

    def change(session: Session) -> tuple[Registration, Sequence[Upload], JobMessage | None]:
        own.check_announced(request, session, service.settings.access, manifest)
        drive, created = drives.register(session, manifest, service.settings.map_id, own.owner_of(request), again)
        first_job = drives.queue_if_complete(session, drive)
        (view,) = drives_out(session, [drive], service.past)
        begun = packs.unfinished(session, drive.id)
        return Registration(id=drive.id, created=created, drive=view, packs=[], missing=[]), begun, first_job

    answer, begun, first_job = await service.write(change)
    indexed = await service.in_thread(lambda: [upload for upload in begun if service.uploads.is_indexed(upload)])
    answer.packs = [OpenPack(upload=f"/v1/uploads/{upload.id}", length=upload.length) for upload in indexed]
    return answer, first_job


@router.get("")
async def newest(request: Request, service: ServiceDep, wanted: Annotated[DriveQuery, Query()]) -> DriveList:
    """Drives, newest first where no other order is asked for; of a vehicle its own."""
    owner = own.owner_name(request)
    asked = drive_search.Asked(owner, wanted.before, wanted.state, wanted.vehicle, wanted.search)

    def read(session: Session) -> DriveList:
        found = drives_out(session, drive_search.page(session, asked, wanted.sort, wanted.limit, wanted.offset), service.past)
        is_whole = len(found) == wanted.limit and wanted.sort == "newest"
        total, states = drive_search.count(session, asked), drive_search.states(session, owner)
        return DriveList(drives=found, next_before=found[-1].created_at if is_whole else None, total=total, states=states)

    return await service.read(read)


@router.get("/{drive_id}")
async def one(drive_id: DriveId, service: ServiceDep) -> DriveOut:
    """One drive with its stages."""
    return await service.read(lambda session: drives_out(session, [drives.get(session, drive_id)], service.past)[0])


@router.get("/{drive_id}/track")
async def track(drive_id: DriveId, service: ServiceDep) -> Feature:
    """Track of the drive as a GeoJSON LineString in WGS84, cut at the antimeridian; no geometry until it is geo-referenced."""
    drive = await service.read(lambda session: drives.shown(session, drive_id))
    geometry = line_geometry(drive.track) if drive.track else None
    return Feature(geometry=geometry, properties={"id": drive.id, "name": drive.name, "state": drive.state})


@router.get("/{drive_id}/preview.png", response_class=Response, responses={200: {"content": {"image/png": {}}}})
async def preview(drive_id: DriveId, service: ServiceDep) -> Response:
    """The drive's labelled points from above, in its own plane; 404 until its submaps are cut."""
    drive = await service.read(lambda session: drives.shown(session, drive_id))
    digest = drive.facts.get("preview")
    if digest is None:
        raise ProtocolError(404, "not-found", f"drive {drive_id[:12]} has no picture yet: its submaps are not cut")
    content = await service.in_thread(lambda: service.blobs.get(digest))
    return Response(content, headers={"ETag": f'"{digest}"', "Cache-Control": "no-cache"}, media_type="image/png")


@router.get("/{drive_id}/quality")
async def quality(drive_id: DriveId, service: ServiceDep) -> dict[str, Any]:
    """Quality report of the drive: docs/formats.md, "Quality of a drive"; 404 until it is geo-referenced."""
    report = await _quality(drive_id, service)
    return {name: value for name, value in report.items() if name != "pictures"} | {"pictures": sorted(report["pictures"])}


@router.get("/{drive_id}/quality/{picture}.svg", response_class=Response, responses={200: {"content": {"image/svg+xml": {}}}})
async def quality_picture(
    drive_id: DriveId, picture: Annotated[str, Path(pattern="^[a-z]{1,32}$")], service: ServiceDep
) -> Response:
    """A picture of the quality report, of those that it names; 404 where the drive has none of the kind."""
    pictures = (await _quality(drive_id, service))["pictures"]
    if picture not in pictures:
        raise ProtocolError(404, "not-found", f"drive {drive_id[:12]} has no picture {picture!r}; it has {', '.join(pictures)}")
    return Response(pictures[picture], headers={"Cache-Control": "no-cache"}, media_type="image/svg+xml")


@router.post("/{drive_id}/release")
async def release(drive_id: DriveId, release: ReleaseIn, service: ServiceDep) -> DriveOut:
    """Merge a held or quarantined drive all the same; who said so and why is kept with it."""
    await service.notify(await service.write(lambda session: gate.release(session, drive_id, release.by, release.why)))
    return await one(drive_id, service)


@router.delete("/{drive_id}/release")
async def revoke(drive_id: DriveId, service: ServiceDep) -> DriveOut:
    """Take the release back: the drive leaves the map with its next version."""
    await service.notify(await service.write(lambda session: gate.revoke(session, drive_id)))
    return await one(drive_id, service)


@router.post("/{drive_id}/retry")
async def retry(drive_id: DriveId, service: ServiceDep, wanted: RetryIn = GO_ON) -> DriveOut:
    """Try the failed stage again, with a fresh set of attempts. Finished stages are kept; where `stage` is given, it and those
    after it are made anew."""
    await service.notify(*await service.write(lambda session: reprocessing.retry(session, drive_id, wanted.stage)))
    return await one(drive_id, service)


@router.post("/{drive_id}/cancel")
async def cancel(drive_id: DriveId, service: ServiceDep) -> DriveOut:
    """Stop the drive's stages: it fails with the error `cancelled`, and `retry` goes on with it. Of a drive that is processed anew
    the result before stays. 409 where no stage is on its way."""

    def change(session: Session) -> None:
        drives.get(session, drive_id)
        jobs.cancel(session, drive_id)

    await service.write(change)
    return await one(drive_id, service)


@router.post("/{drive_id}/reprocess", status_code=202)
async def reprocess(drive_id: DriveId, service: ServiceDep, wanted: ReprocessIn = NOTHING_ELSE) -> DriveOut:
    """Process the drive anew: with the service's settings as they are now, its rig's newest file, or what the body names.

    Map and pages keep the result before until the version with the new one is published, and for good where the run fails; then
    `retry` goes on with it, and another `reprocess` begins a new one. Stages on which nothing has changed are not run again.
    """

    def change(session: Session) -> JobMessage:
        drive = drives.get(session, drive_id)
        facts = {} if wanted.rig_version is None else {"rig": _rig_version(session, drive, wanted.rig_version)}
        return reprocessing.begin(session, drive_id, wanted.asked(), facts)

    await service.notify(await service.write(change))
    return await one(drive_id, service)


@router.get("/{drive_id}/runs")
async def runs_of_drive(drive_id: DriveId, service: ServiceDep) -> RunList:
    """The runs whose submaps the map has or had: for each stage its key, code, libraries and settings."""

    def read(session: Session) -> RunList:
        drives.shown(session, drive_id)
        return RunList(runs=[run_detail(run) for run in runs.of_drives(session, [drive_id])[drive_id]])

    return await service.read(read)


@router.delete("/{drive_id}", status_code=202)
async def remove(drive_id: DriveId, service: ServiceDep) -> DriveOut:
    """Remove the drive for good: its files at once, its part of the map with the next version, which withdraws those before it that
    held the drive: they answer 410 from then on. What it said of its rig is forgotten, and its blobs are deleted."""
    removal = await service.write(lambda session: drives.request_removal(session, drive_id))
    view = await one(drive_id, service)
    await service.notify(removal)
    return view


async def _quality(drive_id: str, service: Service) -> dict[str, Any]:
    drive = await service.read(lambda session: drives.shown(session, drive_id))
    digest = drive.facts.get("quality")
    if digest is None:
        raise ProtocolError(404, "not-found", f"drive {drive_id[:12]} has no quality report yet: it is not geo-referenced")
    found: dict[str, Any] = json.loads(await service.in_thread(lambda: service.blobs.get(digest)))
    return found


def _rig_version(session: Session, drive: Drive, number: int) -> dict[str, Any]:
    """What `facts.rig` says of a drive that shall be tracked with this version of its rig's file."""
    rig = (drive.facts.get("rig") or {}).get("rig")
    if rig is None:
        raise ConflictError(f"drive {drive.id[:12]} names no rig: its log and its manifest say neither vehicle nor rig")
    version = rigs.version(session, rig, number)
    return {"rig": rig, "version": number, "sha256": version.digest, "knocked": False, "asked": True}


def _check_size(service: Service, manifest: Manifest) -> None:
    limits = service.settings
    if len(manifest.files) > limits.max_drive_files:
        raise ProtocolError(413, "too-large", f"the drive has {len(manifest.files)} files, {limits.max_drive_files} are allowed")
    largest = max(manifest.files, key=lambda file: file.size)
    if largest.size > limits.max_file_bytes:
        raise ProtocolError(413, "too-large", f"{largest.path} has {largest.size} bytes, {limits.max_file_bytes} are allowed")


def _registration(service: Service, answer: Registration) -> Iterator[bytes]:
    """The answer as JSON, its missing files page by page: a drive may have 200,000."""
    yield answer.model_dump_json(exclude={"missing"}).encode()[:-1] + b',"missing":['
    furthest = _furthest(service, answer.id)
    after, comma = "", ""
    while True:
        with service.database.read() as session:
            files = drives.missing_files(session, answer.id, after)
        if not files:
            break
        yield (comma + ",".join(_missing(*file, *furthest.get(file[0], (0, None))) for file in files)).encode()
        after, comma = files[-1][0], ","
    yield b"]}"


def _missing(path: str, size: int, sha256: str, offset: int, upload: str | None) -> str:
    return MissingFile(path=path, size=size, sha256=sha256, offset=offset, upload=upload).model_dump_json()


def _furthest(service: Service, drive_id: str) -> dict[str, tuple[int, str]]:
    """For each file that is on its way the unfinished upload that is furthest: how far, and its address."""
    furthest: dict[str, tuple[int, str]] = {}
    with service.database.read() as session:
        open_ones = uploads.unfinished(session, drive_id)
    for upload in open_ones:
        if upload.files_done is not None:
            continue
        size = service.uploads.offset(upload)
        furthest[upload.path] = max(furthest.get(upload.path, (0, "")), (size, f"/v1/uploads/{upload.id}"))
    return furthest
