"""Orthographic side view of the labelled cloud."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID
from wayloom.errors import StageError
from wayloom.tiles.preview import Blocks, Foremost

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]
BACKGROUND = 255


@dataclass(frozen=True, slots=True)
class SideView:
    """Side view of a cloud: image (h, w, 3) RGB; metres_per_pixel; width_m and height_m of its extent."""

    image: Image
    metres_per_pixel: float
    width_m: float
    height_m: float


def main_direction(track: FloatArray) -> FloatArray:
    """(2,) unit vector along which horizontal positions track (N, 2) m spread most, pointing from first to last."""
    centred = track - track.mean(axis=0)
    direction: FloatArray = np.linalg.svd(centred, full_matrices=False)[2][0]
    return direction if (track[-1] - track[0]) @ direction >= 0 else -direction


def side_view(blocks: Blocks, track: FloatArray, width_px: int = 1400, below_m: float = 6.0) -> SideView:
    """Orthographic view across the road: along the track's main direction to the right, up to the top; near points hide far ones.

    blocks : points, third axis up, with labels; track (K, 3) m: camera positions in the same frame
    The frame ends below_m under the lowest camera and where 99.5 % of the points do, at least 8 m above the cameras.
    """
    direction = main_direction(track[:, :2]) if len(track) > 1 else np.array([1.0, 0.0])
    along, height = (np.concatenate([np.zeros(0), *column]) for column in _columns(blocks, direction))
    left, right = np.percentile(along, [0.2, 99.8], overwrite_input=True) if len(along) else (0.0, 1.0)
    bottom = track[:, 2].min() - below_m
    top = max(track[:, 2].max() + 8.0, np.percentile(height, 99.5, overwrite_input=True) if len(height) else 0.0)
    scale = max((right - left) / width_px, 1e-3)
    height_px = int(np.clip(np.ceil((top - bottom) / scale), 60, width_px))
    image = np.full((height_px * width_px, 3), BACKGROUND, np.uint8)
    nearest = Foremost(len(image))
    for points, labels in blocks:
        column = np.floor((points[:, :2] @ direction - left) / scale).astype(np.int64)
        row = height_px - 1 - np.floor((points[:, 2] - bottom) / scale).astype(np.int64)
        inside = (column >= 0) & (column < width_px - 1) & (row >= 1) & (row < height_px)
        towards = points[:, :2] @ np.array([direction[1], -direction[0]])  # the viewer stands to the right of the road
        nearest.add((row * width_px + column)[inside], towards[inside], labels[inside])
    seen, label = nearest.seen()
    for du, dv in ((0, 0), (1, 0), (0, -1), (1, -1)):
        image[seen + dv * width_px + du] = PALETTE_WITH_VOID[label]
    return SideView(image.reshape(height_px, width_px, 3), float(scale), float(right - left), float(top - bottom))


def _columns(blocks: Blocks, direction: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """How far along, and how high the points are, by block."""
    along, height = [], []
    for points, _ in blocks:
        along.append(points[:, :2] @ direction)
        height.append(points[:, 2].copy())
    return along, height


def png_bytes(image: Image) -> bytes:
    """An RGB or grey image as PNG."""
    return _encoded(image, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 9])


def jpeg_bytes(image: Image, quality: int = 85) -> bytes:
    """An RGB or grey image as JPEG."""
    return _encoded(image, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])


def shrunk(image: Image, width_px: int) -> Image:
    """The image with at most this width, each pixel the mean of those it stands for."""
    if image.shape[1] <= width_px:
        return image
    height_px = max(1, round(image.shape[0] * width_px / image.shape[1]))
    return np.asarray(cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _encoded(image: Image, suffix: str, options: list[int]) -> bytes:
    stored = image[:, :, ::-1] if image.ndim == 3 else image
    written, data = cv2.imencode(suffix, np.ascontiguousarray(stored), options)
    if not written:
        raise StageError(f"an image of {image.shape} could not be written as {suffix}")
    return bytes(data.tobytes())
