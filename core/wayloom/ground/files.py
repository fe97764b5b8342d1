"""Folder of ground sheets: `index.json` with the sheet of each submap, `<digest>.ground` with its content."""

from typing import Final

from wayloom.files.submap_folder import INDEX, SubmapFolder
from wayloom.ground.sheet import GroundSheet, decode_sheet

SHEETS: Final[SubmapFolder[GroundSheet]] = SubmapFolder(
    "wayloom-ground", 1, "sheets", "sheet", ".ground", decode_sheet, "ground sheets", "run the stage ground again"
)
save_sheets, sheet_file, read_index, load_sheet = SHEETS.save, SHEETS.file, SHEETS.read_index, SHEETS.load
__all__ = ["INDEX", "SHEETS", "load_sheet", "read_index", "save_sheets", "sheet_file"]
