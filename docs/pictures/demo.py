"""Draws docs/pictures/demo.jpg from what `make demo ONCE=1` left: `python docs/pictures/demo.py [demo-out]`.

Above, a camera image of the first drive and the labels that the network gives it; below, the map that both drives made.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from wayloom.logs.registry import open_log
from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model
from wayloom.segmentation.network import Network
from wayloom.segmentation.overlay import overlay

FRAME, WIDTH_PX, GAP_PX, JPEG_QUALITY = 22, 1280, 8, 86


def main() -> None:
    """Compose the picture beside this script."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "demo-out")
    image = open_log(out / "drives" / "car-1").frame(FRAME).left
    labelled = overlay(image, Network(find_model(DEFAULT_MODEL), 1).labels(image))
    top = np.hstack([image, np.full((image.shape[0], GAP_PX, 3), 255, np.uint8), labelled])
    parts = [top, cv2.imread(str(out / "map.png"))[..., ::-1]]
    scaled = [cv2.resize(p, (WIDTH_PX, round(p.shape[0] * WIDTH_PX / p.shape[1])), interpolation=cv2.INTER_AREA) for p in parts]
    picture = np.vstack([scaled[0], np.full((GAP_PX, WIDTH_PX, 3), 255, np.uint8), scaled[1]])
    target = str(Path(__file__).with_suffix(".jpg"))
    cv2.imwrite(target, picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


if __name__ == "__main__":
    main()
