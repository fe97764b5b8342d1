"""Folder of object sightings: `index.json` with those of each submap, `<digest>.objects` with their content."""

from typing import Final

from wayloom.files.submap_folder import SubmapFolder
from wayloom.objects.types import ObjectSightings, decode_sightings

SIGHTINGS: Final[SubmapFolder[ObjectSightings]] = SubmapFolder(
    "wayloom-objects", 1, "sightings", "sightings", ".objects", decode_sightings, "object sightings", "run the stage objects again"
)
save_all, sightings_file, read_index, load_one = SIGHTINGS.save, SIGHTINGS.file, SIGHTINGS.read_index, SIGHTINGS.load
