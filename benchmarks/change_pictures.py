"""Picture of a street before and after its changes: voxels from above, what has gone in red rings, what is new in green ones.

    python benchmarks/change_pictures.py OUT LOG OUT LOG FILE.jpg

OUT and LOG are those of `benchmarks/change.py changed`. Shown is the square that has most changes: left the map of the first
drive, right that of both.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from change import loaded, mapped
from wayloom.config.classes import PALETTE
from wayloom.stitching.change_types import Change
from wayloom.stitching.region_grid import RegionMap

SIDE_M, PX_PER_M, BAR_PX, GAP_PX = 52.0, 14, 30, 6
RING_M = 2.6
RINGS = {"gone": (215, 25, 25), "new": (20, 140, 40)}
DOT_PX = 3


def main() -> None:
    """Write the picture."""
    out_a, log_a, out_b, log_b, file = map(Path, sys.argv[1:])
    drives = [loaded(out_a, log_a, "first", "own"), loaded(out_b, log_b, "second", "own")]
    before, after = mapped(drives[:1], [0]), mapped(drives, [0, 1])
    changes = [change for region in after for change in region.changes]
    centre = densest(changes)
    titles = ("before", f"after: {sum(shown(one, centre) for one in changes)} things gone")
    panels = [panel(regions, changes, centre, title) for regions, title in zip((before, after), titles, strict=True)]
    image = np.concatenate([panels[0], np.full((panels[0].shape[0], GAP_PX, 3), 255, np.uint8), panels[1]], axis=1)
    file.write_bytes(cv2.imencode(".jpg", np.ascontiguousarray(image[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())


def densest(changes: list[Change]) -> NDArray[np.float64]:
    """(2,) m: the middle of the changes that one square can show most of."""
    at = np.array([one.position_enu[:2] for one in changes])
    inside = (np.abs(at[:, None] - at[None]) < 0.45 * SIDE_M).all(axis=2)
    best = inside[int(np.argmax(inside.sum(axis=1)))]
    return 0.5 * (at[best].min(axis=0) + at[best].max(axis=0))


def shown(change: Change, centre: NDArray[np.float64]) -> bool:
    """Whether a change lies in the square."""
    return bool((np.abs(np.array(change.position_enu[:2]) - centre) < 0.5 * SIDE_M).all())


def panel(regions: list[RegionMap], changes: list[Change], centre: NDArray[np.float64], title: str) -> NDArray[np.uint8]:
    """(h, w, 3) RGB from above, north up: higher voxels over lower ones."""
    side = int(SIDE_M * PX_PER_M)
    image = np.full((side + BAR_PX, side, 3), 24, np.uint8)
    layers = [region.layers[name] for region in regions for name in ("static", "parked")]
    points, label = np.concatenate([one.points_enu for one in layers]), np.concatenate([one.label for one in layers])
    for row in np.argsort(points[:, 2], kind="stable").tolist():
        cv2.circle(image, pixel(points[row], centre), DOT_PX // 2, tuple(np.maximum(PALETTE[label[row]], 60).tolist()), -1)
    for change in changes:
        radius = int(0.5 * PX_PER_M * max(RING_M, *change.extent_m[:2]) + 4)
        cv2.circle(image, pixel(change.position_enu, centre), radius, RINGS[change.kind], 2, cv2.LINE_AA)
    image[:BAR_PX] = 255
    cv2.putText(image, title, (8, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1, cv2.LINE_AA)
    return image


def pixel(place: object, centre: NDArray[np.float64]) -> tuple[int, int]:
    """Column and row of a place (2 or 3,) m."""
    east, north = (np.asarray(place, np.float64)[:2] - centre + [0.5 * SIDE_M, -0.5 * SIDE_M]) * [PX_PER_M, -PX_PER_M]
    return int(east), int(north) + BAR_PX


if __name__ == "__main__":
    main()
