"""Pack endpoints: many small files of a drive as one resumable upload, which is continued as any other (tus)."""

from collections.abc import Sequence
from typing import Any, Final

from fastapi import APIRouter, Depends, Request, Response
from pydantic import BaseModel, Field

from wayloom.store import packs, uploads
from wayloom.store.database import Session
from wayloom.store.packs import PackedFile
from wayloom.store.tables.drives import Upload
from wayloom_services.access import own
from wayloom_services.context import ServiceDep, require_key
from wayloom_services.drives import DriveId
from wayloom_services.errors import Problem, ProtocolError
from wayloom_services.tus import check_space
from wayloom_services.tus_body import forget

PROBLEMS: Final[dict[int | str, dict[str, Any]]] = {
    status: {"model": Problem} for status in (400, 401, 404, 408, 409, 413, 422, 507)
}
router = APIRouter(prefix="/v1", tags=["uploads"], dependencies=[Depends(require_key)], responses=PROBLEMS)


class PackIn(BaseModel):
    """The files of a pack, in the order in which their bytes will come."""

    paths: list[str] = Field(min_length=1, max_length=packs.MOST_FILES)


class PackOut(BaseModel):
    """A pack that was begun."""

    upload: str | None = Field(description="where it is sent to and continued; null where every file has arrived already")
    length: int = Field(description="bytes of all its files together")
    skipped: list[str] = Field(description="files that have arrived already: they are not part of the pack")


class PackedFileOut(BaseModel):
    """A file of a pack."""

    path: str
    size: int
    sha256: str


class PackFiles(BaseModel):
    """The files of a pack, in the order of their bytes."""

    files: list[PackedFileOut]


@router.post("/drives/{drive_id}/packs", status_code=201, summary="Begin a pack of small files")
async def begin(drive_id: DriveId, wanted: PackIn, request: Request, response: Response, service: ServiceDep) -> PackOut:
    """Its bytes are those of the files, one behind the other; they are sent with PATCH to `upload`, from the offset that HEAD
    tells, with `Upload-Pieces` if they are to be verified on the way. Each file is verified and stored as soon as it is whole."""

    def make(session: Session) -> tuple[Upload | None, Sequence[PackedFile]]:
        files = packs.lacking(session, drive_id, wanted.paths)
        if not files:
            return None, files
        own.check_upload(request, session, service.settings.access, drive_id, sum(file.size for file in files))
        return packs.create(session, drive_id, files), files

    upload, files = await service.write(make)
    kept = {file.path for file in files}
    skipped = [path for path in wanted.paths if path not in kept]
    if upload is None:
        return PackOut(upload=None, length=0, skipped=skipped)
    try:
        await check_space(service, upload.length)
        await service.in_thread(lambda: service.uploads.index(upload, files))
        await service.write(lambda session: uploads.prolong(session, upload.id, service.settings.upload_expiry_s))
    except BaseException:  # a row without an index is of no use, and counts
        await forget(service, upload)
        raise
    address = f"/v1/uploads/{upload.id}"
    response.headers["Location"] = address
    return PackOut(upload=address, length=upload.length, skipped=skipped)


@router.get("/uploads/{upload_id}/files", summary="What a pack is made of")
async def files_of_pack(upload_id: str, service: ServiceDep) -> PackFiles:
    """For a client that goes on with a pack which it did not begin itself."""
    upload = await service.read(lambda session: uploads.find(session, upload_id))
    if upload.files_done is None:
        raise ProtocolError(409, "conflict", "this is the upload of one file, not of a pack")
    pack = await service.in_thread(lambda: service.uploads.pack(upload))
    return PackFiles(files=[PackedFileOut(path=file.path, size=file.size, sha256=file.sha256) for file in pack.files])
