"""Ground sheets of drives as their stages left them.

They are evidence of the drive, like its looks: they stay in its folder and go with it.
"""

from collections.abc import Iterable
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

import structlog

from wayloom.errors import InputError
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.placed_sheet import PlacedSheet
from wayloom.store import jobs
from wayloom.submaps.submap import PlacedSubmap
from wayloom_workers.stage_hooks import WorkerContext

log = structlog.get_logger()
GROUND: Final = "ground"
"""The stage that makes sheets."""
HELD_SHEETS: Final = 48


class DriveSheets:
    """The sheets of drives, those that neighbouring regions share unpacked once."""

    def __init__(self, context: WorkerContext) -> None:
        self._context = context
        self._sheet = lru_cache(HELD_SHEETS)(load_sheet)
        self._of_drive: dict[str, tuple[Path, dict[str, str]]] = {}

    def digest(self, drive_id: str, submap: str) -> str | None:
        """The digest of a submap's sheet; None where the drive has left none that can be read, as before there were sheets."""
        return self._listed(drive_id)[1].get(submap)

    def placed(self, submaps: Iterable[PlacedSubmap]) -> list[PlacedSheet]:
        """The sheets of these submaps, where they lie."""
        found = []
        for item in submaps:
            folder, sheets = self._listed(item.drive_id)
            digest = sheets.get(item.submap.digest)
            if digest is not None and self._can_be_read(item.drive_id, folder, digest):
                read = partial(self._sheet, folder, digest)
                found.append(PlacedSheet(item.drive_id, digest, read, item.T_enu_submap, item.covariance))
        return found

    def _can_be_read(self, drive_id: str, folder: Path, digest: str) -> bool:
        try:
            self._sheet(folder, digest)
        except InputError as error:
            log.warning("a submap shows no ground", drive_id=drive_id, error=str(error))
            return False
        return True

    def _listed(self, drive_id: str) -> tuple[Path, dict[str, str]]:
        """The folder of the drive's sheets, and for each submap the digest of its sheet."""
        if drive_id not in self._of_drive:
            with self._context.database.read() as session:
                key = jobs.keys_of_outputs(session, drive_id, (GROUND,)).get(GROUND)
            folder = self._context.folders.drive(drive_id) / "stages" / GROUND / (key or "")
            self._of_drive[drive_id] = folder, {} if key is None else _index(folder, drive_id)
        return self._of_drive[drive_id]


def _index(folder: Path, drive_id: str) -> dict[str, str]:
    try:
        return read_index(folder)
    except InputError as error:
        log.warning("drive shows no ground", drive_id=drive_id, error=str(error))
        return {}
