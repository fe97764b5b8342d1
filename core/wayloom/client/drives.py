"""The drives of a service: page by page, and the archive of one."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from wayloom.client.api import Api
from wayloom.config.progress import Progress
from wayloom.errors import ServiceError
from wayloom.files.atomic import check_writable, replacing

PAGE: Final = 500
MEGABYTE: Final = 1e6
ALMOST: Final = 0.99
"""Share beyond which an estimate of the length does not lead."""


def all_drives(api: Api) -> Iterator[dict[str, Any]]:
    """Every drive, newest first, as `GET /v1/drives` tells it. Raises ServiceError."""
    before: float | None = None
    while True:
        page = api.json("GET", "/v1/drives", params={"limit": PAGE} | ({} if before is None else {"before": before}))
        yield from page["drives"]
        before = page["next_before"]
        if before is None:
            return


def download_archive(api: Api, drive_id: str, out: Path, progress: Progress) -> int:
    """Write the zip of all that a drive has led to; how many bytes. `out` is whole or as it was before.

    Raises AnswerError, ServiceError where the archive breaks off, OSError.
    """
    check_writable(out)
    count = 0
    with api.streamed(f"/v1/drives/{drive_id}/archive.zip") as answer, replacing(out) as file:
        about = max(float(answer.headers.get("wayloom-length-estimate", "0")), 1.0)
        for block in answer.iter_bytes():
            file.write(block)
            count += len(block)
            progress(min(count / about, ALMOST), f"{count / MEGABYTE:.1f} MB")
        if not zipfile.is_zipfile(file):
            raise ServiceError(f"what {api.url} sent is no whole archive; ask for it again")
    progress(1.0, f"{count / MEGABYTE:.1f} MB")
    return count
