"""Polling of a drive's state on the server, until it is in the map or has failed."""

import time
from collections.abc import Callable
from typing import Any

from wayloom.client.api import Api

OVER = ("done", "failed")


def wait_for_drive(
    api: Api, drive_id: str, on_progress: Callable[[dict[str, Any]], None] = lambda _drive: None, poll_s: float = 0.5
) -> dict[str, Any]:
    """Poll until the drive is done or has failed; returns the last answer. `on_progress` is given each answer.

    Raises NotFoundError, ServiceError."""
    while True:
        drive = api.drive(drive_id)
        on_progress(drive)
        if drive["state"] in OVER:
            return drive
        time.sleep(poll_s)
