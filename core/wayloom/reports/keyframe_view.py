"""Pictures of a keyframe: its labelled points as its camera sees them, and its image with labels, without persons."""

from collections.abc import Mapping
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID, PERSONS
from wayloom.geometry import se3
from wayloom.segmentation.overlay import overlay, without_persons
from wayloom.submaps.submap import Submap

Image = NDArray[np.uint8]
GROUND: Final = (18, 22, 25)
NEAREST_M: Final = 1.0
FARTHEST_M: Final = 80.0
DOT_AT_1_M_PX: Final = 26.0
MOST_DOT_PX: Final = 7
VIEW_WIDTH_PX: Final = 960


def points_view(submap: Submap, keyframe: int, camera: Mapping[str, Any]) -> tuple[Image, int]:
    """The submap's points in the left image of one of its keyframes, near ones over far ones; and how many are in view.

    keyframe : row of the submap's keyframes
    camera   : width, height, fx, fy, cx, cy in px, as `log.json` has them
    returns  (h, w, 3) RGB, as wide as VIEW_WIDTH_PX; points of persons are not drawn
    """
    scale = VIEW_WIDTH_PX / camera["width"]
    width, height = VIEW_WIDTH_PX, round(scale * camera["height"])
    image = np.full((height, width, 3), GROUND, np.uint8)
    points = se3.transform(np.linalg.inv(submap.T_submap_cam[keyframe]), submap.xyz.astype(np.float64))
    depth = points[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = scale * (camera["fx"] * points[:, 0] / depth + camera["cx"] + 0.5) - 0.5
        v = scale * (camera["fy"] * points[:, 1] / depth + camera["cy"] + 0.5) - 0.5
    seen = (depth > NEAREST_M) & (depth < FARTHEST_M) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    rows = np.flatnonzero(seen & ~np.isin(submap.label, PERSONS))
    for row in rows[np.argsort(-depth[rows])]:
        radius = int(np.clip(DOT_AT_1_M_PX / depth[row], 1, MOST_DOT_PX))
        centre, colour = (round(float(u[row])), round(float(v[row]))), PALETTE_WITH_VOID[submap.label[row]].tolist()
        cv2.circle(image, centre, radius, colour, -1, cv2.LINE_AA)
    return image, len(rows)


def labelled_image(image: Image, labels: Image, uv: NDArray[np.floating[Any]], share: float) -> Image:
    """An image with its labels over it and the points that were tracked in it.

    image  (h, w) grey or (h, w, 3) RGB; labels (h, w) train ids; uv (N, 2) px; share of the labels' colour, 0 to 1
    """
    shown = overlay(without_persons(image, labels), labels, share)
    for u, v in np.rint(uv).astype(int).tolist():
        cv2.circle(shown, (u, v), 2, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(shown, (u, v), 1, (214, 64, 20), -1, cv2.LINE_AA)
    return shown


def webp_bytes(image: Image, quality: int = 82) -> bytes:
    """An RGB image as WebP."""
    done, content = cv2.imencode(".webp", image[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert done
    return content.tobytes()
