"""Endpoints of a drive's keyframes: when and where they are, what was seen there as points, and their image while that is kept."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Depends, Path, Query, Response
from numpy.typing import NDArray

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store import drives, jobs, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Session
from wayloom.store.drive_files import FETCHED
from wayloom.store.images import check_kept
from wayloom.store.tables.drives import Drive, SubmapRow
from wayloom.submaps.submap import Submap, decode_submap
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS, DriveId
from wayloom_services.schemas.keyframes import KeyframeList, KeyframeOut

WEBP: Final[dict[int | str, dict[str, Any]]] = {200: {"content": {"image/webp": {}}}}
HELD: Final = 12
"""Submaps in memory: whoever scrubs through a drive asks for the same ones again."""
LISTED: Final = 4096
"""Submaps whose tables of keyframes are in memory, about a kilobyte each."""
Number = Annotated[int, Path(ge=0, lt=2**31, description="as the list numbers them")]
router = APIRouter(
    prefix="/v1/drives/{drive_id}/keyframes", tags=["drives"], dependencies=[Depends(require_key)], responses=PROBLEMS
)


class ElsewhereError(ConflictError):
    """The images of a drive are kept, but not where this process can read them."""

    code = "images-elsewhere"


@dataclass(frozen=True, slots=True)
class _Keyframes:
    """A submap's K keyframes: frame (K,) of the drive, t_ns (K,) and points (K,), of how many each is the host."""

    frame: NDArray[np.uint32]
    t_ns: NDArray[np.int64]
    points: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, slots=True)
class _Found:
    """A keyframe: its submap, its row there, and the facts of its drive."""

    submap: Submap
    row: int
    facts: dict[str, Any]


@router.get("")
async def keyframes(drive_id: DriveId, service: ServiceDep) -> KeyframeList:
    """The keyframes in the order of the road, and whether their images are there; none before the submaps are cut."""
    drive, rows = await _rows(drive_id, service)

    def read() -> list[KeyframeOut]:
        found: list[KeyframeOut] = []
        for row in rows:
            listed = _keyframes(service.blobs, row.digest)
            columns = listed.frame.tolist(), listed.t_ns.tolist(), listed.points.tolist()
            for k, (frame, t_ns, hosted) in enumerate(zip(*columns, strict=True)):
                lon, lat = [None, None] if k >= len(row.track) else row.track[k]
                found.append(KeyframeOut(number=len(found), frame=frame, t_s=t_ns * 1e-9, points=hosted, lon=lon, lat=lat))
        return found

    return KeyframeList(
        keyframes=await service.in_thread(read), images=drive.images, retention=str(service.settings.uploads.retention)
    )


@router.get("/{number}/points.webp", response_class=Response, responses=WEBP)
async def points(drive_id: DriveId, number: Number, service: ServiceDep) -> Response:
    """What the map has of this stretch, as the keyframe's left camera sees it: labelled points on dark ground."""
    found = await _keyframe(drive_id, number, service)
    camera = (found.facts.get("log") or {}).get("camera")
    if camera is None:
        raise NotFoundError(f"nothing is known of the camera of drive {drive_id[:12]}")
    content = await service.in_thread(lambda: _points(found, camera))
    return Response(content, headers={"Cache-Control": "private, max-age=600"}, media_type="image/webp")


@router.get("/{number}/image.webp", response_class=Response, responses=WEBP)
async def image(
    drive_id: DriveId,
    number: Number,
    service: ServiceDep,
    labels: Annotated[float, Query(ge=0, le=1, description="share of the labels' colour")] = 0.45,
) -> Response:
    """The keyframe's left image with its labels and the points that were tracked in it, persons painted over; 409 where the images
    of the drive were deleted, or lie in the object store alone."""
    drive, _ = await _rows(drive_id, service)
    check_kept(drive)
    found = await _keyframe(drive_id, number, service)
    frame = int(found.submap.keyframe_frame[found.row])
    keys = await service.read(lambda session: jobs.keys_of_outputs(session, drive_id, ["odometry", "segmentation"]))
    content = await service.in_thread(lambda: _image(service, drive, keys, frame, labels))
    return Response(content, headers={"Cache-Control": "no-store"}, media_type="image/webp")


def _points(found: _Found, camera: Mapping[str, Any]) -> bytes:
    from wayloom_services.keyframe_pictures import picture_of_points

    return picture_of_points(found.submap, found.row, camera)


def _image(service: Service, drive: Drive, keys: Mapping[str, str], frame: int, share: float) -> bytes:
    from wayloom_services.keyframe_pictures import picture_of_image

    home = service.folders.drive(drive.id)
    if service.uploads.in_objects and not (home / FETCHED).exists():
        raise ElsewhereError(
            f"the images of drive {drive.id[:12]} lie in the object store: no worker has fetched them hither of late"
        )
    return picture_of_image(home, drive, keys, frame, share)


async def _rows(drive_id: str, service: Service) -> tuple[Drive, list[SubmapRow]]:
    def read(session: Session) -> tuple[Drive, list[SubmapRow]]:
        return drives.shown(session, drive_id), [*maps.submaps_of(session, drive_id)]

    return await service.read(read)


async def _keyframe(drive_id: str, number: int, service: Service) -> _Found:
    drive, rows = await _rows(drive_id, service)

    def find() -> _Found:
        left = number
        for row in rows:
            count = len(_keyframes(service.blobs, row.digest))
            if left < count:
                return _Found(_submap(service.blobs, row.digest), left, drive.facts)
            left -= count
        raise NotFoundError(f"drive {drive_id[:12]} has no keyframe {number}")

    return await service.in_thread(find)


@lru_cache(maxsize=LISTED)
def _keyframes(blobs: BlobStore, digest: str) -> _Keyframes:
    """By copies, so that the submap's bytes can go."""
    submap = _submap(blobs, digest)
    points = np.bincount(submap.keyframe, minlength=len(submap.keyframe_frame))
    return _Keyframes(submap.keyframe_frame.copy(), submap.keyframe_t_ns.copy(), points)


@lru_cache(maxsize=HELD)
def _submap(blobs: BlobStore, digest: str) -> Submap:
    return decode_submap(blobs.get(digest), digest)
