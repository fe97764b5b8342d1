"""The drives of a service, page by page."""

from collections.abc import Iterator
from typing import Any, Final

from wayloom.client.api import Api

PAGE: Final = 500


def all_drives(api: Api) -> Iterator[dict[str, Any]]:
    """Every drive, newest first, as `GET /v1/drives` tells it. Raises ServiceError."""
    before: float | None = None
    while True:
        page = api.json("GET", "/v1/drives", params={"limit": PAGE} | ({} if before is None else {"before": before}))
        yield from page["drives"]
        before = page["next_before"]
        if before is None:
            return
