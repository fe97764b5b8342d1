"""Endpoints of what a drive has led to: its report as a page, its track, its cloud, its log while that is kept."""

import json
import tarfile
from collections.abc import Iterator
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Query, Response
from fastapi.responses import StreamingResponse

from wayloom.errors import NotFoundError
from wayloom.reports.served_drive import render
from wayloom.store import drives, history, maps
from wayloom.store.database import Session
from wayloom.store.images import check_kept
from wayloom.store.tables.drives import SubmapRow
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drive_points import DrivePoints
from wayloom_services.drives import PROBLEMS, DriveId
from wayloom_services.schemas.history import EventOut, History
from wayloom_services.views import drives_out

POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'; sandbox"
"""Of a page that stands by itself: it loads nothing and runs nothing."""
router = APIRouter(prefix="/v1/drives/{drive_id}", tags=["drives"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/report.html", response_class=Response, responses={200: {"content": {"text/html": {}}}})
async def report(drive_id: DriveId, service: ServiceDep) -> Response:
    """The drive's quality report as one page that needs no other file; 404 until it is geo-referenced."""

    def read(session: Session) -> tuple[dict[str, Any], str | None]:
        row = drives.shown(session, drive_id)
        return drives_out(session, [row], service.past)[0].model_dump(mode="json"), (row.facts or {}).get("quality")

    drive, digest = await service.read(read)
    if digest is None:
        raise NotFoundError(f"drive {drive_id[:12]} has no report yet: it is not geo-referenced")
    found = json.loads(await service.in_thread(lambda: service.blobs.get(digest)))
    page = await service.in_thread(lambda: render(drive, found, found["pictures"]))
    return Response(page, headers={"Content-Security-Policy": POLICY, "Cache-Control": "no-cache"}, media_type="text/html")


@router.get("/history")
async def events(
    drive_id: DriveId,
    service: ServiceDep,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    before: Annotated[int | None, Query(ge=1, le=2**53, description="`next` of the page before")] = None,
) -> History:
    """What became of each attempt at the drive's stages, newest first."""

    def read(session: Session) -> History:
        drives.shown(session, drive_id)
        rows = history.of_drive(session, drive_id, limit, before)
        found = [EventOut.of(row) for row in rows]
        return History(events=found, next=rows[-1].id if len(rows) == limit else None)

    return await service.read(read)


@router.get("/trajectory.tum", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def trajectory(drive_id: DriveId, service: ServiceDep) -> Response:
    """Poses of the keyframes in the map's frame, east, north, up, where the newest version has them: time, place, quaternion."""
    name, points = await _points(drive_id, service)
    content = await service.in_thread(points.trajectory)
    return Response(content, headers=as_download(name, "tum"), media_type="text/plain")


@router.get("/cloud.ply", response_class=Response, responses={200: {"content": {"application/octet-stream": {}}}})
async def cloud(drive_id: DriveId, service: ServiceDep) -> Response:
    """The drive's labelled points as PLY, as `wayloom process` writes it; persons left out."""
    name, points = await _points(drive_id, service)
    size, blocks = await service.in_thread(points.cloud)
    headers = {**as_download(name, "ply"), "Content-Length": str(size)}
    return StreamingResponse(blocks, headers=headers, media_type="application/octet-stream")


@router.get("/log.tar", response_class=Response, responses={200: {"content": {"application/x-tar": {}}}})
async def log(drive_id: DriveId, service: ServiceDep) -> Response:
    """What the drive has sent, as a tar archive; 409 where its images were deleted or have not arrived."""
    drive = await service.read(lambda session: drives.shown(session, drive_id))
    check_kept(drive)
    archive = _tar(service.uploads.files(drive_id), int(drive.uploaded_at or 0))
    return StreamingResponse(archive, headers=as_download(drive.name, "tar"), media_type="application/x-tar")


async def _points(drive_id: str, service: Service) -> tuple[str, DrivePoints]:
    """The drive's name, and its poses and points. Raises NotFoundError."""

    def read(session: Session) -> tuple[str, list[SubmapRow]]:
        return drives.shown(session, drive_id).name, [*maps.submaps_of(session, drive_id)]

    name, rows = await service.read(read)
    if not rows:
        raise NotFoundError(f"drive {drive_id[:12]} has no submaps yet")
    return name, DrivePoints(service.blobs, rows)


def as_download(drive_name: str, suffix: str) -> dict[str, str]:
    """The header that names a file after its drive."""
    name = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "-_.") else "-" for letter in drive_name)
    return {"Content-Disposition": f'attachment; filename="{name}.{suffix}"'}


def _tar(files: Iterator[tuple[str, int, Iterator[bytes | memoryview]]], at: int) -> Iterator[bytes]:
    """What a drive has sent as tar, a block at a time: it may have a hundred gigabytes."""
    for path, size, blocks in files:
        info = tarfile.TarInfo(path)
        info.size, info.mtime = size, at
        yield info.tobuf(tarfile.PAX_FORMAT)
        yield from map(bytes, blocks)
        yield b"\0" * (-size % tarfile.BLOCKSIZE)
    yield b"\0" * 2 * tarfile.BLOCKSIZE
