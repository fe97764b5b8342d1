"""Object sightings of drives as their stages left them. Like sheets they stay in the drive's folder and go with it."""

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Final

import structlog

from wayloom.errors import InputError
from wayloom.objects.files import load_one, read_index
from wayloom.objects.types import PlacedSightings
from wayloom.store import jobs
from wayloom.submaps.submap import PlacedSubmap
from wayloom_workers.stage_hooks import WorkerContext

log = structlog.get_logger()
OBJECTS: Final = "objects"
"""The stage that makes sightings."""
HELD_SIGHTINGS: Final = 256
"""In memory at a time, some ten kilobytes each."""


class DriveSightings:
    """The sightings of drives, those that neighbouring regions share read once."""

    def __init__(self, context: WorkerContext) -> None:
        self._context = context
        self._sightings = lru_cache(HELD_SIGHTINGS)(load_one)
        self._of_drive: dict[str, tuple[Path, dict[str, str]]] = {}

    def digest(self, drive_id: str, submap: str) -> str | None:
        """The digest of the sightings along a submap; None where the drive has left none that can be read."""
        return self._listed(drive_id)[1].get(submap)

    def placed(self, submaps: Iterable[PlacedSubmap]) -> list[PlacedSightings]:
        """The sightings along these submaps, where they lie."""
        found = []
        for item in submaps:
            folder, listed = self._listed(item.drive_id)
            digest = listed.get(item.submap.digest)
            if digest is None:
                continue
            try:
                found.append(PlacedSightings(self._sightings(folder, digest), item.T_enu_submap, item.covariance, item.drive_id))
            except InputError as error:
                log.warning("a submap shows no objects", drive_id=item.drive_id, error=str(error))
        return found

    def _listed(self, drive_id: str) -> tuple[Path, dict[str, str]]:
        """The folder of the drive's sightings, and for each submap the digest of its own."""
        if drive_id not in self._of_drive:
            with self._context.database.read() as session:
                key = jobs.keys_of_outputs(session, drive_id, (OBJECTS,)).get(OBJECTS)
            folder = self._context.folders.drive(drive_id) / "stages" / OBJECTS / (key or "")
            self._of_drive[drive_id] = folder, {} if key is None else _index(folder, drive_id)
        return self._of_drive[drive_id]


def _index(folder: Path, drive_id: str) -> dict[str, str]:
    try:
        return read_index(folder)
    except InputError as error:
        log.warning("drive shows no objects", drive_id=drive_id, error=str(error))
        return {}
