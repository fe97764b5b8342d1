"""Picture of a drive from above, the labelled points that it shows, and image files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, overload

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.georeference.types import GeoReference
from wayloom.pipeline.plane import T_plane_enu
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.preview import top_down

JPEG_QUALITY: Final = 90


class PlacedPoints(Sequence[tuple[NDArray[np.float64], NDArray[np.uint8]]]):
    """Points (n, 3) m of each submap in the drive's plane, by T_plane_enu (4, 4), and their labels (n,), made when they are asked
    for: one submap at a time is in memory."""

    def __init__(self, submaps: Sequence[PlacedSubmap], T_plane_enu: NDArray[np.float64]) -> None:
        self._submaps, self._T_plane_enu = submaps, T_plane_enu

    def __len__(self) -> int:
        return len(self._submaps)

    @overload
    def __getitem__(self, row: int) -> tuple[NDArray[np.float64], NDArray[np.uint8]]: ...
    @overload
    def __getitem__(self, row: slice) -> Sequence[tuple[NDArray[np.float64], NDArray[np.uint8]]]: ...
    def __getitem__(self, row: int | slice) -> Any:
        if isinstance(row, slice):
            return PlacedPoints(self._submaps[row], self._T_plane_enu)
        placed = self._submaps[row]
        return se3.transform(self._T_plane_enu, placed.points_enu()), placed.submap.label


def drive_map(geo: GeoReference, submaps: Sequence[PlacedSubmap]) -> NDArray[np.uint8]:
    """(h, w, 3) RGB: the points of the drive's submaps from above, with its track."""
    T = T_plane_enu(geo)
    track = se3.transform(T, geo.T_enu_cam[:, :3, 3])
    return top_down(PlacedPoints(submaps, T), tracks_enu=(track,), north_up=geo.frame is not None)


def write_image(file: Path, image: NDArray[np.uint8]) -> None:
    """An RGB image (h, w, 3) as PNG or JPEG, by the file's suffix."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if file.suffix == ".jpg" else []
    written, data = cv2.imencode(file.suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    if not written:
        raise StageError(f"{file}: an image of {image.shape} could not be encoded")
    file.write_bytes(data.tobytes())


def read_image(file: Path) -> NDArray[np.uint8]:
    """(h, w, 3) RGB. Raises StageError where the file is no image."""
    image = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise StageError(f"{file}: no readable image; run the drive again")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
