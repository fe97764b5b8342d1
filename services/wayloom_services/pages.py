"""Pages of the dashboard. They hold nothing of anybody: what they show they ask of /v1 with the rights of whoever looks."""

import re
from functools import cache
from typing import Final

from fastapi import APIRouter, Request, Response

from wayloom_services.assets import Assets
from wayloom_services.errors import ProtocolError

DRIVE_ID: Final = re.compile("[0-9a-f]{64}")
router = APIRouter(include_in_schema=False)


@cache
def assets() -> Assets:
    """The dashboard's files, read once a process."""
    return Assets()


@router.get("/")
async def dashboard(request: Request) -> Response:
    """Map and list of drives."""
    return await assets().page("index", request)


@router.get("/3d")
async def view3d(request: Request) -> Response:
    """The map's points in 3D."""
    return await assets().page("view3d", request)


@router.get("/sign-in")
async def sign_in(request: Request) -> Response:
    """Where people say who they are."""
    return await assets().page("sign-in", request)


@router.get("/fleet")
async def fleet(request: Request) -> Response:
    """Vehicles, queues, workers, storage."""
    return await assets().page("fleet", request)


@router.get("/areas")
async def areas(request: Request) -> Response:
    """Excluded areas."""
    return await assets().page("areas", request)


@router.get("/access")
async def access(request: Request) -> Response:
    """Keys and audit log."""
    return await assets().page("access", request)


@router.get("/drives/{drive_id}")
async def drive(drive_id: str, request: Request) -> Response:
    """One drive. Raises ProtocolError where the address is no drive's; whether there is such a drive, the page asks."""
    if not DRIVE_ID.fullmatch(drive_id):
        raise ProtocolError(404, "not-found", f"{drive_id[:80]!r} is no drive's id, which has 64 hexadecimal digits")
    return await assets().page("drive", request)
