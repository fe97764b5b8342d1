"""Makes docs/pictures/objects.jpg: `python docs/pictures/objects.py OUT LOG FRAME`, of a processed drive and the log of it.

The objects that the drive found, drawn over its left image of the keyframe next to FRAME, with their probabilities.
"""

import sys
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from wayloom.geometry import se3
from wayloom.logs.registry import open_log
from wayloom.objects.exports import objects_of_drive
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import KINDS, STANDING, MapObject
from wayloom.submaps.files import load_submaps

TARGET = Path(__file__).parent / "objects.jpg"
NEAREST_M, FURTHEST_M = 3.0, 24.0
COLOURS: Final = {"pole": (255, 80, 255), "traffic_sign": (255, 255, 0), "traffic_light": (255, 160, 0), "trunk": (80, 255, 80)}
ZOOM: Final = 2
"""Times by which the image is enlarged, so that boxes are finer than its pixels."""


def main(out: Path, log_path: Path, frame: int) -> None:
    """Draw what is near the frame."""
    log, submaps = open_log(log_path), load_submaps(out / "stages" / "submaps")
    found = objects_of_drive(out / "stages" / "objects", submaps, ObjectFusionSettings())
    _, placed, at = min(
        (abs(int(one) - frame), number, k)
        for number, item in enumerate(submaps)
        for k, one in enumerate(item.submap.keyframe_frame)
    )
    item = submaps[placed]
    picture = log.frame(int(item.submap.keyframe_frame[at])).left
    picture = picture if picture.ndim == 3 else picture[..., None].repeat(3, axis=2)
    image = cv2.resize(picture, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_CUBIC)
    T_cam_enu = se3.inverse(item.T_enu_submap @ item.submap.T_submap_cam[at])
    for one in found:
        draw(image, one, T_cam_enu, log.rig.camera)
    cv2.imwrite(str(TARGET), np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])


def draw(image: np.ndarray, one: MapObject, T_cam_enu: np.ndarray, camera: object) -> None:
    """The box of an object, as wide and as tall as it is."""
    standing = KINDS.index(one.kind) in STANDING
    down, up = (0.0, one.height_m) if standing else (-0.5 * (one.height_m - one.bottom_m), 0.5 * (one.height_m - one.bottom_m))
    ends = se3.transform(T_cam_enu, one.position + np.array([[0.0, 0.0, down], [0.0, 0.0, up]]))
    if not NEAREST_M < ends[0, 2] < FURTHEST_M or ends[1, 2] < NEAREST_M:
        return
    (u0, v0), (u1, v1) = ZOOM * camera.project(ends)
    half = ZOOM * max(0.5 * one.width_m * camera.fx / ends[0, 2], 1.5)
    cv2.rectangle(image, (round(min(u0, u1) - half), round(v1)), (round(max(u0, u1) + half), round(v0)), COLOURS[one.kind], 2)
    cv2.putText(image, f"{one.confidence:.2f}", (round(u1 - 16), max(round(v1) - 5, 14)), 0, 0.5, COLOURS[one.kind], 1, cv2.LINE_AA)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
