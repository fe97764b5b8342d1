"""Ground sheet: rasters of the ground along one submap (height, classes, orthophoto), immutable and addressed by its content.

A sheet has a frame of its own: its origin is the submap's, its z axis was up and its x axis east (of a drive without GNSS: right of
its first camera) when it was made. What it holds comes from the odometry, the images and their labels, so where it lies follows the
submap: T_enu_sheet = T_enu_submap T_submap_sheet, and nothing in it changes when the map is optimised.

Rasters are indexed [row, column]: rows along y, columns along x, cell [0, 0] at the low corner. A cell of the height grid
(`CELL_M`) holds 2 x 2 pixels of the orthophoto (`PIXEL_M`). Only ground is in a sheet: no cell shows a person, a vehicle, or what
stands on the ground.

Its bytes are a `wayloom.files.blob` (`docs/formats.md`, "Ground sheets"); each raster is packed by itself.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, VOID
from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.ground.packing import packed, unpacked

FloatArray = NDArray[np.float64]
CELL_M: Final = 0.10
PIXEL_M: Final = 0.05
GROUND_CLASSES: Final = tuple(CLASS_ID[name] for name in ("road", "sidewalk", "terrain"))
"""Train ids of the rasters of votes, in their order."""
NO_HEIGHT: Final = -32768
"""Of `height_mm`: a cell without surface."""
LARGEST_SIGMA_MM: Final = 255
VOTE_UNIT: Final = 0.01
"""1/m: votes are sums of inverse depths (eq. 3 of the paper), in these steps."""
MAGIC: Final = b"WLGROUND"
VERSION: Final = 1
LEVEL: Final = 4
RASTERS: Final[dict[str, np.dtype[Any]]] = {
    "height_mm": np.dtype("<i2"), "sigma_mm": np.dtype("|u1"), "votes": np.dtype("<u2"),
    "colour": np.dtype("|u1"), "sharpness": np.dtype("|u1"),
}  # fmt: skip
DTYPES: Final = {"T_submap_sheet": "<f8", "corner": "<i4", "t_ns": "<i8", "start": "<i8", "packed": "|u1"}


@dataclass(frozen=True)
class GroundSheet:
    """Rasters of H x W cells.

    submap          digest of the submap that it belongs to
    T_submap_sheet  (4, 4) float64, rigid
    corner          (2,) int32 column and row of cell [0, 0]: its low corner is at corner * CELL_M in the sheet's frame
    t_ns            (2,) int64 times of the first and the last image that it was made of
    height_mm       (H, W) int16 z of the surface, sheet frame; NO_HEIGHT where there is none
    sigma_mm        (H, W) uint8 its sigma, relative to the submap, rounded up; LARGEST_SIGMA_MM for all that is more
    votes           (H, W, 3) uint16 in steps of VOTE_UNIT, of GROUND_CLASSES, summed over all views of the cell
    colour          (2H, 2W, C) uint8, C = 3 (RGB) or 1 (grey): the orthophoto in the drive's balanced exposure; 0 where unseen
    sharpness       (2H, 2W) uint8 image pixels a metre of ground in the direction in which they are fewest, of the views that
                    made the colour, 1 to 255; 0 where nothing was seen (the alpha of the orthophoto)
    """

    submap: str
    T_submap_sheet: FloatArray
    corner: NDArray[np.int32]
    t_ns: NDArray[np.int64]
    height_mm: NDArray[np.int16]
    sigma_mm: NDArray[np.uint8]
    votes: NDArray[np.uint16]
    colour: NDArray[np.uint8]
    sharpness: NDArray[np.uint8]

    def __post_init__(self) -> None:
        rows, columns = self.height_mm.shape
        wanted = {
            "sigma_mm": (rows, columns), "votes": (rows, columns, len(GROUND_CLASSES)), "sharpness": (2 * rows, 2 * columns),
        }  # fmt: skip
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} is {getattr(self, name).shape}, not {shape}, where the heights are {rows} x {columns}")
        if self.colour.shape not in ((2 * rows, 2 * columns, 1), (2 * rows, 2 * columns, 3)):
            raise ValueError(f"the colour is {self.colour.shape} where the heights are {rows} x {columns}")

    @property
    def height(self) -> FloatArray:
        """(H, W) m, sheet frame; NaN where there is no surface."""
        return np.where(self.height_mm == NO_HEIGHT, np.nan, self.height_mm / 1000.0)

    @property
    def corner_m(self) -> FloatArray:
        """(2,) x and y of the low corner of cell [0, 0], sheet frame."""
        return np.asarray(self.corner * CELL_M, np.float64)

    @property
    def label(self) -> NDArray[np.uint8]:
        """(H, W) train id with the most votes, the first of equals; VOID without votes."""
        best = np.asarray(GROUND_CLASSES, np.uint8)[np.argmax(self.votes, axis=2)]
        return np.where(self.votes.any(axis=2), best, VOID).astype(np.uint8)

    @cached_property
    def encoded(self) -> bytes:
        """The sheet's bytes."""
        streams = [packed(getattr(self, name), dtype, LEVEL) for name, dtype in RASTERS.items()]
        header = {"submap": self.submap, "shape": [*self.height_mm.shape, self.colour.shape[2]]}
        arrays = {
            "T_submap_sheet": self.T_submap_sheet.astype("<f8"),
            "corner": self.corner.astype("<i4"),
            "t_ns": self.t_ns.astype("<i8"),
            "start": np.concatenate([[0], np.cumsum([len(one) for one in streams])]).astype("<i8"),
            "packed": np.frombuffer(b"".join(streams), np.uint8),
        }
        return encode_blob(MAGIC, VERSION, header, arrays)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the bytes, hexadecimal: the sheet's name."""
        return hashlib.sha256(self.encoded).hexdigest()


def decode_sheet(data: bytes, name: str = "ground sheet") -> GroundSheet:
    """The sheet of these bytes. Raises InputError when they are none, cut off or of another version."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        rows, columns, channels = header["shape"]
        shapes: dict[str, tuple[int, ...]] = {
            "height_mm": (rows, columns), "sigma_mm": (rows, columns), "votes": (rows, columns, len(GROUND_CLASSES)),
            "colour": (2 * rows, 2 * columns, channels), "sharpness": (2 * rows, 2 * columns),
        }  # fmt: skip
        start, streams = arrays.pop("start"), arrays.pop("packed")
        rasters: dict[str, Any] = {
            raster: unpacked(streams[start[k] : start[k + 1]].data, dtype, shapes[raster])
            for k, (raster, dtype) in enumerate(RASTERS.items())
        }
        return GroundSheet(submap=header["submap"], **arrays, **rasters)
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"is no ground sheet or is damaged ({error})", file=name, remedy="run the stage ground again") from error
