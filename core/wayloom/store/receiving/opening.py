"""Opening of the place in which a service keeps its uploads."""

from wayloom.config.retention import UploadSettings
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.objects import Objects
from wayloom.store.receiving.folder import FolderPlace
from wayloom.store.receiving.objects import ObjectPlace
from wayloom.store.receiving.places import UploadPlace


def objects_of(settings: UploadSettings) -> Objects | None:
    """The object store of the settings; None where uploads go into the data folder. Raises ConfigError."""
    return None if settings.url is None else Objects(settings.url)


def open_place(settings: UploadSettings, folders: Folders, database: Database) -> UploadPlace:
    """The place of the settings. Raises ConfigError."""
    objects = objects_of(settings)
    return FolderPlace(folders) if objects is None else ObjectPlace(objects, database)
