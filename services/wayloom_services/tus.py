"""Resumable upload endpoints (tus 1.0.0): creation, creation-with-upload, checksum, expiration, termination.

The offset is the size of the stored file, whatever happened before. A chunk with a checksum waits beside the file until it is whole
and right; one with the sums of its pieces is kept up to the last whole piece that is right; one without is kept as far as it came.
When a file is whole, its SHA-256 must be the manifest's.
"""

import shutil
import time
from typing import Any

from fastapi import APIRouter, Depends, Request, Response

from wayloom.errors import ChecksumMismatchError, OffsetConflictError
from wayloom.store import uploads
from wayloom.store.database import Session
from wayloom.store.tables.drives import Upload
from wayloom_services.access import own
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.errors import Problem, ProtocolError
from wayloom_services.tus_body import checks_of, complete, forget, receive
from wayloom_services.tus_headers import (
    CHECKSUMS,
    CONTENT_TYPE,
    EXTENSIONS,
    PIECES,
    VERSION,
    check_version,
    date,
    integer,
    metadata,
)

PROBLEMS: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem} for status in (400, 401, 404, 408, 409, 410, 412, 413, 415, 423, 460, 507)
}
router = APIRouter(prefix="/v1/uploads", tags=["uploads"], dependencies=[Depends(require_key)], responses=PROBLEMS)
_BODY = {"requestBody": {"content": {CONTENT_TYPE: {"schema": {"type": "string", "format": "binary"}}}, "required": False}}


@router.options("", status_code=204, summary="What this server can do")
@router.options("/{upload_id}", status_code=204, include_in_schema=False)
async def capabilities(service: ServiceDep) -> Response:
    """Versions, extensions, largest file and checksums."""
    headers = {
        "Tus-Version": VERSION,
        "Tus-Extension": EXTENSIONS,
        "Tus-Max-Size": str(service.settings.max_file_bytes),
        "Tus-Checksum-Algorithm": ",".join(CHECKSUMS),
        "Upload-Pieces": PIECES,
    }
    return _answer(204, headers)


@router.post("", status_code=201, summary="Start the upload of a file", openapi_extra=_BODY)
async def create(request: Request, service: ServiceDep) -> Response:
    """Headers: Upload-Length; Upload-Metadata with `drive` and `path`; the body may hold the first bytes, or all of them."""
    check_version(request)
    length = integer(request, "upload-length")
    if length > service.settings.max_file_bytes:
        raise ProtocolError(
            413, "too-large", f"{length} bytes are more than the {service.settings.max_file_bytes} allowed for a file"
        )
    await check_space(service, length)
    header = request.headers.get("upload-metadata", "")
    given = metadata(header)
    drive, path = given.get("drive", ""), given.get("path", "")
    with_body = request.headers.get("content-type") == CONTENT_TYPE
    checks = checks_of(request) if with_body else None
    expiry_s = service.settings.upload_expiry_s

    def begin(session: Session) -> Upload:
        own.check_upload(request, session, service.settings.access, drive, length)
        return uploads.create(session, drive, path, length, header, expiry_s)

    upload = await service.write(begin)
    offset = 0
    async with service.locks.hold(upload.id) as hold:
        try:
            offset = await receive(request, service, upload, 0, checks, hold) if with_body else 0
        except (ProtocolError, ChecksumMismatchError):  # the client does not know the upload's address yet
            await forget(service, upload)
            raise
        if offset == length:
            await complete(service, upload)
    headers = {"Location": f"/v1/uploads/{upload.id}", "Upload-Offset": str(offset), "Upload-Expires": date(upload.expires_at)}
    return _answer(201, headers)


@router.head("/{upload_id}", summary="How far the upload is")
async def offset(upload_id: str, request: Request, service: ServiceDep) -> Response:
    """Upload-Offset, Upload-Length, Upload-Metadata, Upload-Expires. A request that is still being received ends, so that the
    offset is the last word; a file that was whole when the server died is finished now."""
    check_version(request)
    async with service.locks.hold(upload_id):
        upload = await _find(service, upload_id)
        stored = await service.in_thread(lambda: service.uploads.offset(upload))
        if stored == upload.length and not upload.complete:
            await complete(service, upload)
    headers = {
        "Upload-Offset": str(stored),
        "Upload-Length": str(upload.length),
        "Upload-Metadata": upload.metadata_header,
        "Upload-Expires": date(upload.expires_at),
    }
    return _answer(200, headers)


@router.patch("/{upload_id}", status_code=204, summary="Continue the upload", openapi_extra=_BODY)
async def append(upload_id: str, request: Request, service: ServiceDep) -> Response:
    """Headers: Upload-Offset, which must be where the stored bytes end; Upload-Checksum or Upload-Pieces if the chunk is to be
    verified."""
    check_version(request)
    if request.headers.get("content-type") != CONTENT_TYPE:
        raise ProtocolError(415, "wrong-content-type", f"a chunk is sent as {CONTENT_TYPE}")
    start, checks = integer(request, "upload-offset"), checks_of(request)
    async with service.locks.hold(upload_id) as hold:
        upload = await _find(service, upload_id)
        stored = await service.in_thread(lambda: service.uploads.offset(upload))
        if start != stored:
            raise OffsetConflictError(f"{stored} bytes are stored, the chunk starts at {start}: ask with HEAD and continue there")
        if start < upload.length or request.headers.get("content-length", "0") != "0":
            await check_space(service, upload.length - start)
            stored = await receive(request, service, upload, start, checks, hold)
        if stored == upload.length and not upload.complete:
            await complete(service, upload)
        until = await service.write(lambda session: uploads.prolong(session, upload_id, service.settings.upload_expiry_s))
    return _answer(204, {"Upload-Offset": str(stored), "Upload-Expires": date(until)})


@router.delete("/{upload_id}", status_code=204, summary="Give the upload up")
async def terminate(upload_id: str, request: Request, service: ServiceDep) -> Response:
    """The stored bytes are dropped."""
    check_version(request)
    async with service.locks.hold(upload_id):
        upload = await _find(service, upload_id)
        if upload.complete:
            raise ProtocolError(409, "conflict", f"{upload.path} is complete and belongs to its drive: remove the drive instead")
        await forget(service, upload)
    return _answer(204, {})


async def _find(service: Service, upload_id: str) -> Upload:
    upload = await service.read(lambda session: uploads.find(session, upload_id))
    if not upload.complete and upload.expires_at < time.time():
        raise ProtocolError(410, "expired", "the upload was not continued for too long: start it again")
    return upload


async def check_space(service: Service, wanted: int) -> None:
    """Refuse before the first byte what would fill the disk; an object store is never full."""
    if service.uploads.in_objects:
        return
    free = await service.in_thread(lambda: shutil.disk_usage(service.settings.data_dir).free)
    if free - wanted < service.settings.min_free_bytes:
        raise ProtocolError(507, "no-space", f"{free} bytes are free, {wanted} more are wanted and a reserve is kept")


def _answer(status: int, headers: dict[str, str]) -> Response:
    return Response(status_code=status, headers={"Tus-Resumable": VERSION, "Cache-Control": "no-store", **headers})
