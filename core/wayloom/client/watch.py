"""Progress of a drive on the server, until it is in the map or stays outside of it."""

import time
from collections.abc import Set
from typing import Any

from wayloom.client.api import Api
from wayloom.config.progress import NamedProgress, silent_for_each

NEARLY_DONE = 0.999
OVER = ("done", "held", "quarantined", "failed")


def wait_for_drive(
    api: Api,
    drive_id: str,
    progress: NamedProgress = silent_for_each,
    done_before: Set[str] = frozenset(),
    poll_s: float = 0.5,
) -> dict[str, Any]:
    """Ask until the drive is done, held, quarantined or has failed. Returns the last answer. Raises NotFoundError, ServiceError.

    progress    : of each stage by its name
    done_before : stages that an earlier upload of the drive has been through, of which no time is told
    """
    while True:
        drive = api.drive(drive_id)
        for stage in drive["stages"]:
            if stage["state"] != "waiting":
                progress(stage["stage"])(_share(stage), _words(stage, stage["stage"] in done_before))
        if drive["state"] in OVER:
            return drive
        time.sleep(poll_s)


def _share(stage: dict[str, Any]) -> float:
    """How far the stage is; whole only when its result is kept, which takes a moment after its work."""
    share = float(stage["progress"])
    return share if stage["state"] == "done" else min(share, NEARLY_DONE)


def _words(stage: dict[str, Any], before: bool) -> str:
    if stage["state"] == "done":
        return "done before" if before else f"done in {stage['seconds']:.1f} s"
    return str(stage["message"] or stage["state"])
