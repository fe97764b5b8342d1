"""Folder of object sightings: `index.json` with those of each submap, `<digest>.objects` with their content."""

from typing import Final

from wayloom.files.submap_folder import SubmapFolder
from wayloom.objects.types import ObjectSightings, decode_sightings

SIGHTINGS: Final[SubmapFolder[ObjectSightings]] = SubmapFolder(
    format="wayloom-objects",
    version=1,
    entries="sightings",
    entry="sightings",
    suffix=".objects",
    decode=decode_sightings,
    words="object sightings",
    remedy="run the stage objects again",
)
save_all, sightings_file, read_index, load_one = SIGHTINGS.save, SIGHTINGS.file, SIGHTINGS.read_index, SIGHTINGS.load
