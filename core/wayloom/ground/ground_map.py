"""Ground of one region of the map: height, classes and orthophoto, and what they were made of.

Its bytes are a `wayloom.files.blob` (`docs/formats.md`, "Ground of a region"): equal ground gives equal bytes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import VOID
from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.ground.packing import packed, unpacked
from wayloom.ground.sheet import GROUND_CLASSES

MAGIC: Final = b"WLGRDMAP"
VERSION: Final = 2
LEVEL: Final = 4
"""Of the packing: the rasters of a region are tens of megabytes."""
NO_HEIGHT: Final = -(2**31)
LARGEST_SIGMA_MM: Final = 65_535
RASTERS: Final[dict[str, str]] = {
    "height_mm": "<i4", "sigma_mm": "<u2", "own_sigma_mm": "<u2", "votes": "<u4", "looks": "|u1", "newest": "<u2", "colour": "|u1",
    "sharpness": "|u1", "shown": "<u2",
}  # fmt: skip
DTYPES: Final = {"corner": "<i4", "t_ns": "<i8", "place_sigma_mm": "<u2", "start": "<i8", "packed": "|u1"}


@dataclass(frozen=True)
class GroundMap:
    """H x W cells of 10 cm, 2H x 2W pixels of 5 cm, S sheets.

    corner     (2,) column and row of cell [0, 0] in the map's grid: its low corner is at corner * CELL_M, m east and north
    height_mm  (H, W) z in the map's frame; NO_HEIGHT where there is none
    sigma_mm   (H, W) of it, that of its place in the map included; 0 where there is none
    own_sigma_mm  (H, W) without that: of the height relative to the ground around
    votes      (H, W, 3) of GROUND_CLASSES, in steps of `sheet.VOTE_UNIT`, summed over all sheets
    looks      (H, W) how many sheets have the cell, 255: that many or more
    newest     (H, W) the sheet, counted from 1, that saw the cell last; 0: none
    colour     (2H, 2W, C) C = 3 (RGB), 1 where all sheets are grey
    sharpness  (2H, 2W) image pixels a metre; 0 where nothing was seen
    shown      (2H, 2W) the sheet, counted from 1, whose colour it is; 0: none
    sheets     drive and digest of each sheet, sorted; t_ns (S, 2) times of its first and last image; place_sigma_mm (S,) of its
               submap's place in the plane, along its worst axis, LARGEST_SIGMA_MM where it is not known
    """

    corner: NDArray[np.int32]
    height_mm: NDArray[np.int32]
    sigma_mm: NDArray[np.uint16]
    own_sigma_mm: NDArray[np.uint16]
    votes: NDArray[np.uint32]
    looks: NDArray[np.uint8]
    newest: NDArray[np.uint16]
    colour: NDArray[np.uint8]
    sharpness: NDArray[np.uint8]
    shown: NDArray[np.uint16]
    sheets: tuple[tuple[str, str], ...]
    t_ns: NDArray[np.int64]
    place_sigma_mm: NDArray[np.uint16]

    @property
    def is_empty(self) -> bool:
        """Whether nothing was seen."""
        return not self.shown.any() and not self.looks.any()

    @property
    def label(self) -> NDArray[np.uint8]:
        """(H, W) train id with the most votes, the first of equals; VOID without votes."""
        best = np.asarray(GROUND_CLASSES, np.uint8)[np.argmax(self.votes, axis=2)]
        return np.where(self.votes.any(axis=2), best, VOID).astype(np.uint8)

    def encoded(self) -> bytes:
        """Its bytes."""
        streams = [packed(getattr(self, name), dtype, LEVEL) for name, dtype in RASTERS.items()]
        header = {"shape": [*self.height_mm.shape, self.colour.shape[2]], "sheets": [list(one) for one in self.sheets]}
        arrays: dict[str, NDArray[Any]] = {
            "corner": self.corner.astype("<i4"),
            "t_ns": self.t_ns.reshape(-1, 2).astype("<i8"),
            "place_sigma_mm": self.place_sigma_mm.astype("<u2"),
            "start": np.cumsum([0, *map(len, streams)]).astype("<i8"),
            "packed": np.frombuffer(b"".join(streams), np.uint8),
        }
        return encode_blob(MAGIC, VERSION, header, arrays)


class GroundFile:
    """The ground of a region in its bytes: each raster is unpacked when it is asked for."""

    def __init__(self, data: bytes, name: str = "ground") -> None:
        self._name = name
        self._header, self._arrays = self._checked(lambda: decode_blob(data, MAGIC, VERSION, DTYPES))
        rows, columns, channels = self._checked(lambda: tuple(map(int, self._header["shape"])))
        cells, pixels = (rows, columns), (2 * rows, 2 * columns)
        self._shapes: dict[str, tuple[int, ...]] = {
            "height_mm": cells, "sigma_mm": cells, "own_sigma_mm": cells, "votes": (*cells, 3), "looks": cells, "newest": cells,
            "colour": (*pixels, channels), "sharpness": pixels, "shown": pixels,
        }  # fmt: skip

    def raster(self, name: str) -> NDArray[Any]:
        """One raster of `GroundMap` by its name. Raises InputError where it is damaged."""
        row = [*RASTERS].index(name)
        start, streams = self._arrays["start"], self._arrays["packed"]
        found: NDArray[Any] = self._checked(
            lambda: unpacked(streams[start[row] : start[row + 1]].data, RASTERS[name], self._shapes[name])
        )
        return found

    def ground_map(self) -> GroundMap:
        """All of it."""
        rasters: dict[str, Any] = {name: self.raster(name) for name in RASTERS}
        sheets = self._checked(lambda: tuple((drive_id, digest) for drive_id, digest in self._header["sheets"]))
        arrays = {name: self._arrays[name] for name in ("corner", "t_ns", "place_sigma_mm")}
        return GroundMap(sheets=sheets, **arrays, **rasters)

    @property
    def place_sigma_mm(self) -> NDArray[np.uint16]:
        """(S,) as in `GroundMap`."""
        return np.asarray(self._arrays["place_sigma_mm"], np.uint16)

    def _checked(self, read: Callable[[], Any]) -> Any:
        try:
            return read()
        except (ValueError, KeyError, TypeError, IndexError) as error:
            message = f"is no ground of a region or is damaged ({error})"
            raise InputError(message, file=self._name, remedy="have the map stitched anew") from error


def decode_ground(data: bytes, name: str = "ground") -> GroundMap:
    """The inverse of `GroundMap.encoded`. Raises InputError for bytes that are none."""
    return GroundFile(data, name).ground_map()
