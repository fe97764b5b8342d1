"""Reading of point cloud files: LAZ, LAS and PLY, ours and others'."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import laspy
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, VOID
from wayloom.errors import InputError, UnknownFormatError
from wayloom.exports.las import ASPRS_OF_CLASS, FULL_RANGE
from wayloom.files.ply import read_ply

SUFFIXES: Final = (".laz", ".las", ".ply")
CLASS_OF_ASPRS: Final = np.full(256, VOID, np.uint8)
for _name, _number in ASPRS_OF_CLASS.items():
    if _name != "terrain":  # the standard has one class, ground, for sidewalk and terrain
        CLASS_OF_ASPRS[_number] = CLASS_ID[_name]
CLASS_OF_ASPRS[[3, 4]] = CLASS_ID["vegetation"]
CLASS_OF_ASPRS[2] = CLASS_ID["terrain"]


@dataclass(frozen=True, slots=True)
class CloudFile:
    """points (N, 3) float64 m as the file has them, labels (N,) train ids with 255 void, photo (N, 3) uint8 RGB or grey of the
    images; is_geographic: whether the axes are east, north and up by a coordinate system."""

    points: NDArray[np.float64]
    labels: NDArray[np.uint8]
    photo: NDArray[np.uint8]
    is_geographic: bool


def read_cloud(path: Path) -> CloudFile:
    """The points of a file. Labels are read from the extra dimension `label`, else from the LAS classes. Raises InputError."""
    if path.suffix not in SUFFIXES:
        raise UnknownFormatError(
            f"{path.suffix or 'a file without ending'} is no cloud", file=path, remedy=f"known are {', '.join(SUFFIXES)}"
        )
    if path.suffix == ".ply":
        found = read_ply(path)
        return CloudFile(found.points, found.labels, found.colours, False)
    try:
        las = laspy.read(path)
    except (OSError, ValueError, laspy.errors.LaspyException, RuntimeError) as error:
        raise InputError(f"cannot be read as LAS ({error})", file=path, remedy="give a .laz or .las file") from error
    dimensions = {*las.point_format.dimension_names}
    labels = np.asarray(las["label"], np.uint8) if "label" in dimensions else CLASS_OF_ASPRS[np.asarray(las.classification)]
    return CloudFile(np.asarray(las.xyz), labels, _photo(las, dimensions), las.header.parse_crs() is not None)


def _photo(las: laspy.LasData, dimensions: set[str]) -> NDArray[np.uint8]:
    """Ours tell the grey value of the image as intensity, and colours of classes; of others' the colours are photographs."""
    if "label" not in dimensions and {"red", "green", "blue"} <= dimensions:
        colours = np.column_stack([las[name] for name in ("red", "green", "blue")])
        return (colours // (FULL_RANGE if colours.max(initial=0) > VOID else 1)).astype(np.uint8)
    grey = np.asarray(las.intensity, np.int64)
    scaled = grey // FULL_RANGE if "label" in dimensions else 255 * grey // max(int(grey.max(initial=1)), 1)
    return np.repeat(scaled.astype(np.uint8)[:, None], 3, axis=1)
