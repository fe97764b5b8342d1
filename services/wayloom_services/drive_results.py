"""Endpoints of what a drive has led to: its report as a page, its track, its cloud, its log while that is kept."""

import json
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Depends, Query, Response
from fastapi.responses import FileResponse, StreamingResponse
from starlette.background import BackgroundTask

from wayloom.config.classes import PERSONS
from wayloom.errors import NotFoundError
from wayloom.exports.ply import write_ply
from wayloom.exports.points import PointBatch, batch_of_submap
from wayloom.files.trajectory_files import write_tum
from wayloom.geodesy.map_frame import MapFrame
from wayloom.reports.served_drive import render
from wayloom.store import drives, history, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Session
from wayloom.store.images import check_kept
from wayloom.store.manifest import FOLDERS
from wayloom.store.tables.drives import Drive, SubmapRow
from wayloom.submaps.submap import PlacedSubmap, decode_submap
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS, DriveId
from wayloom_services.schemas.history import EventOut, History
from wayloom_services.views import drives_out

POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'; sandbox"
"""Of a page that stands by itself: it loads nothing and runs nothing."""
BLOCK: Final = 2**20
router = APIRouter(prefix="/v1/drives/{drive_id}", tags=["drives"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/report.html", response_class=Response, responses={200: {"content": {"text/html": {}}}})
async def report(drive_id: DriveId, service: ServiceDep) -> Response:
    """The drive's quality report as one page that needs no other file; 404 until it is geo-referenced."""

    def read(session: Session) -> tuple[dict[str, Any], str | None]:
        row = drives.shown(session, drive_id)
        return drives_out(session, [row])[0].model_dump(mode="json"), (row.facts or {}).get("quality")

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
    drive, rows = await _submaps(drive_id, service)
    return await service.in_thread(lambda: _file(drive, "tum", "text/plain", lambda path: _write_poses(service, rows, path)))


@router.get("/cloud.ply", response_class=Response, responses={200: {"content": {"application/octet-stream": {}}}})
async def cloud(drive_id: DriveId, service: ServiceDep) -> Response:
    """The drive's labelled points as PLY, as `wayloom process` writes it; persons left out."""
    drive, rows = await _submaps(drive_id, service)
    return await service.in_thread(
        lambda: _file(drive, "ply", "application/octet-stream", lambda p: _write_cloud(service, rows, p))
    )


@router.get("/log.tar", response_class=Response, responses={200: {"content": {"application/x-tar": {}}}})
async def log(drive_id: DriveId, service: ServiceDep) -> Response:
    """What the drive has sent, as a tar archive; 409 where its images were deleted or have not arrived."""
    drive = await service.read(lambda session: drives.shown(session, drive_id))
    check_kept(drive)
    folder = service.folders.drive(drive_id)
    return StreamingResponse(_tar(folder), headers=as_download(drive.name, "tar"), media_type="application/x-tar")


async def _submaps(drive_id: str, service: Service) -> tuple[Drive, list[SubmapRow]]:
    def read(session: Session) -> tuple[Drive, list[SubmapRow]]:
        return drives.shown(session, drive_id), [*maps.submaps_of(session, drive_id)]

    drive, rows = await service.read(read)
    if not rows:
        raise NotFoundError(f"drive {drive_id[:12]} has no submaps yet")
    return drive, rows


def placed_submap(blobs: BlobStore, row: SubmapRow) -> PlacedSubmap:
    """A row with its points, where the newest version has it."""
    frame = None if row.frame is None else MapFrame(*row.frame)
    T = np.array(row.T_enu_submap, np.float64)
    return PlacedSubmap(decode_submap(blobs.get(row.digest)), T, np.full((6, 6), np.nan), row.drive_id, frame)


def _write_poses(service: Service, rows: list[SubmapRow], path: Path) -> None:
    placed = [placed_submap(service.blobs, row) for row in rows]
    t_ns = np.concatenate([one.submap.keyframe_t_ns for one in placed])
    T = np.concatenate([one.T_enu_submap @ one.submap.T_submap_cam for one in placed])
    _, first = np.unique(t_ns, return_index=True)  # neighbours share the keyframe at which they meet
    write_tum(path, t_ns[first], T[first])


def _write_cloud(service: Service, rows: list[SubmapRow], path: Path) -> None:
    first = placed_submap(service.blobs, rows[0])
    write_ply(path, (without_persons(placed_submap(service.blobs, row)) for row in rows), first.T_enu_submap[:3, 3], first.frame)


def without_persons(placed: PlacedSubmap) -> PointBatch:
    """The points of a submap that no person is among."""
    batch = batch_of_submap(placed)
    return batch.take(~np.isin(batch.label, PERSONS))


def _file(drive: Drive, suffix: str, media_type: str, write: Any) -> FileResponse:
    """A file that is made now and forgotten when it is sent."""
    with tempfile.NamedTemporaryFile(prefix="wayloom-", suffix=f".{suffix}", delete=False) as made:
        path = Path(made.name)
    try:
        write(path)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    headers = as_download(drive.name, suffix)
    return FileResponse(path, headers=headers, media_type=media_type, background=BackgroundTask(path.unlink, missing_ok=True))


def as_download(drive_name: str, suffix: str) -> dict[str, str]:
    """The header that names a file after its drive."""
    name = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "-_.") else "-" for letter in drive_name)
    return {"Content-Disposition": f'attachment; filename="{name}.{suffix}"'}


def _tar(folder: Path) -> Iterator[bytes]:
    """The log's folders as tar, a block at a time: a drive may have a hundred gigabytes."""
    for path in (path for top in FOLDERS for path in sorted((folder / top).rglob("*")) if path.is_file()):
        about = path.stat()
        info = tarfile.TarInfo(path.relative_to(folder).as_posix())
        info.size, info.mtime = about.st_size, int(about.st_mtime)
        yield info.tobuf(tarfile.PAX_FORMAT)
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                yield block
        yield b"\0" * (-info.size % tarfile.BLOCKSIZE)
    yield b"\0" * 2 * tarfile.BLOCKSIZE
