"""Endpoint of a drive's archive: all that it has led to, in one zip that is made while it is sent."""

from typing import TYPE_CHECKING, Final

from fastapi import APIRouter, Depends, Response
from fastapi.responses import StreamingResponse

from wayloom.exports.ply import VERTEX
from wayloom.store import drives, history, jobs, maps
from wayloom.store.database import Session
from wayloom_services.archive.zip_stream import zip_stream
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drive_results import as_download
from wayloom_services.drives import PROBLEMS, DriveId
from wayloom_services.schemas.history import EventOut
from wayloom_services.views import drives_out

if TYPE_CHECKING:
    from wayloom_services.archive.contents import DriveContents

ESTIMATE: Final = "Wayloom-Length-Estimate"
"""Header: how many bytes there will be about, for progress bars. Of a zip that is made on the way nobody knows it exactly."""
router = APIRouter(prefix="/v1/drives/{drive_id}", tags=["drives"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get(
    "/archive.zip",
    response_class=Response,
    responses={
        200: {
            "content": {"application/zip": {}},
            "headers": {ESTIMATE: {"description": "about how many bytes there will be", "schema": {"type": "integer"}}},
        }
    },
)
async def archive(drive_id: DriveId, service: ServiceDep) -> Response:
    """All that the drive has led to as one zip: its keyframes' poses, track, labelled points without persons, objects, pictures of
    the ground, quality report, log of attempts, as far as it has come; README.txt in it says what is what. It is made while it is
    sent: one that breaks off has no directory, and no reader takes it for whole."""
    contents = await service.read(lambda session: _contents(service, session, drive_id))
    await service.in_thread(contents.check)
    points = sum(row.point_count for row in contents.rows)
    headers = {**as_download(contents.drive["name"], "zip"), ESTIMATE: str(points * VERTEX.itemsize), "Cache-Control": "no-store"}
    blocks = zip_stream(contents.members(), contents.drive["finished_at"] or contents.drive["created_at"])
    return StreamingResponse(blocks, headers=headers, media_type="application/zip")


def _contents(service: Service, session: Session, drive_id: str) -> "DriveContents":
    """All that the database says of the drive, by one transaction. Raises NotFoundError."""
    from wayloom_services.archive.contents import STAGES, DriveContents  # with it comes scipy

    row = drives.shown(session, drive_id)
    facts, stages = row.facts or {}, service.folders.drive(drive_id) / "stages"
    return DriveContents(
        blobs=service.blobs,
        drive=drives_out(session, [row], service.past)[0].model_dump(mode="json"),
        track=row.track,
        history=[EventOut.of(one).model_dump(mode="json") for one in history.of_drive(session, drive_id, history.MOST)],
        quality=facts.get("quality"),
        preview=facts.get("preview"),
        rows=[*maps.submaps_of(session, drive_id)],
        folders={stage: stages / stage / key for stage, key in jobs.keys_of_outputs(session, drive_id, STAGES).items()},
    )
