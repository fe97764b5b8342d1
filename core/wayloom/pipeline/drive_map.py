"""Picture of a drive from above, the labelled cloud that it shows, and image files."""

from collections.abc import Sequence
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


def drive_map(geo: GeoReference, submaps: Sequence[PlacedSubmap]) -> NDArray[np.uint8]:
    """(h, w, 3) RGB: the points of the drive's submaps from above, with its track."""
    T = T_plane_enu(geo)
    points, labels = cloud(submaps, T)
    track = se3.transform(T, geo.T_enu_cam[:, :3, 3])
    return top_down(points, labels, tracks_enu=(track,), north_up=geo.frame is not None)


def cloud(submaps: Sequence[PlacedSubmap], T: NDArray[np.float64] | None = None) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """points (N, 3) m in the map's frame, or the drive's own, moved by T (4, 4) where it is given, and labels (N,) of all
    submaps."""
    ends = np.cumsum([0, *(len(placed.submap.xyz) for placed in submaps)])
    points, labels = np.empty((ends[-1], 3)), np.empty(ends[-1], np.uint8)
    for placed, start, end in zip(submaps, ends, ends[1:], strict=False):
        points[start:end] = placed.points_enu() if T is None else se3.transform(T, placed.points_enu())
        labels[start:end] = placed.submap.label
    return points, labels


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
