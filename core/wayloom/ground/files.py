"""Folder of ground sheets: `index.json` with the sheet of each submap, `<digest>.ground` with its content."""

from typing import Final

from wayloom.files.submap_folder import SubmapFolder
from wayloom.ground.sheet import GroundSheet, decode_sheet

SHEETS: Final[SubmapFolder[GroundSheet]] = SubmapFolder(
    format="wayloom-ground",
    version=1,
    entries="sheets",
    entry="sheet",
    suffix=".ground",
    decode=decode_sheet,
    words="ground sheets",
    remedy="run the stage ground again",
)
save_sheets, read_index, load_sheet = SHEETS.save, SHEETS.read_index, SHEETS.load
