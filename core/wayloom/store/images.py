"""State of a drive's images: kept, deleting, deleted, or returning while they are sent once more.

What a drive has sent goes as a whole, and with it what its stages made of single images: pixels' classes and points with grey
values. The state is written before the first file goes, so that nothing begins to read what a sweeper is about to delete.
"""

from typing import Final

from wayloom.errors import ConflictError
from wayloom.store.tables.drives import Drive

KEPT: Final = "kept"
DELETING: Final = "deleting"
DELETED: Final = "deleted"
RETURNING: Final = "returning"


class ImagesDeletedError(ConflictError):
    """The request needs the images of a drive, and these were deleted."""

    code = "images-deleted"


def check_kept(drive: Drive) -> None:
    """Raise ImagesDeletedError where a stage of the drive could not read its log."""
    if drive.images != KEPT:
        raise ImagesDeletedError(
            f"the images of drive {drive.id[:12]} were deleted (setting uploads.retention): send the same log once more, "
            "`wayloom upload LOG --again`, then ask again"
        )
