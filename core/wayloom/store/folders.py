"""Layout of the data folder."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Folders:
    """Paths only; nothing is made here.

    uploads/ID.part                  bytes of an upload that have arrived
    uploads/ID.pack, ID.N            the files of a pack, and what has arrived of the Nth
    drives/ID/log, drives/ID/gnss    the drive's files, each verified
    drives/ID/fetched.json           those files lie in an object store and are here as they lie there
    drives/ID/stages/STAGE/KEY       a finished stage, KEY = hash of inputs, parameters and code version
    drives/ID/parts/STAGE/KEY        finished parts of a stage that is not yet finished
    drives/ID/attempts/STAGE-…       a stage that is running, or was when its worker died
    maps/ID/stages, parts, attempts  the same for a map's jobs
    trash/                           folders that are being deleted
    blobs/                           submaps and tiles by digest
    """

    root: Path

    @property
    def uploads(self) -> Path:
        """Folder of unfinished uploads."""
        return self.root / "uploads"

    @property
    def blobs(self) -> Path:
        """Folder of the local blob store."""
        return self.root / "blobs"

    @property
    def trash(self) -> Path:
        """Folder of folders that are being deleted."""
        return self.root / "trash"

    def drive(self, drive_id: str) -> Path:
        """Folder of one drive."""
        return self.all_drives / drive_id

    @property
    def all_drives(self) -> Path:
        """Folder of the folders of drives."""
        return self.root / "drives"

    def map(self, map_id: str) -> Path:
        """Folder of one map's jobs."""
        return self.all_maps / map_id

    @property
    def all_maps(self) -> Path:
        """Folder of the folders of maps."""
        return self.root / "maps"
