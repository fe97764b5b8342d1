"""Picture of a drive from above, the labelled points that it shows, and image files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

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


@dataclass(frozen=True, slots=True)
class PlacedPoints:
    """Points (N, 3) m of each submap in the map's frame, or the drive's own, moved by T (4, 4) where it is given, and their labels
    (N,): however often they are gone through, one submap at a time is in memory."""

    submaps: Sequence[PlacedSubmap]
    T: NDArray[np.float64] | None = None

    def __iter__(self) -> Iterator[tuple[NDArray[np.float64], NDArray[np.uint8]]]:
        for placed in self.submaps:
            points = placed.points_enu()
            yield points if self.T is None else se3.transform(self.T, points), placed.submap.label


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
