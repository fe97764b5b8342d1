"""Picture of a wall that two drives saw: from above, each drive in its colour, before and after the drives were registered."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.types import Meeting

FloatArray = NDArray[np.float64]
PX_PER_M, SIDE_M, BAR_PX = 22, 26.0, 34
COLOURS = ((40, 90, 220), (230, 120, 20))
"""RGB of the first and the second drive."""
LOW_M, HIGH_M = 0.3, 4.0
UPRIGHT = tuple(CLASS_ID[name] for name in ("building", "wall", "fence", "pole", "traffic sign", "vegetation"))


def wall_picture(file: Path, a: PlacedDrive, b: PlacedDrive, meetings: tuple[Meeting, ...]) -> None:
    """Write the JPEG: left where GNSS puts the second drive, right where the meetings put it.

    Shown is the square with most points of both drives after registration: walls, poles and trees, LOW_M to HIGH_M above the road.
    """
    points_a = upright(a, [item.T_enu_submap for item in a.submaps])
    before = upright(b, [item.T_enu_submap for item in b.submaps])
    after = upright(b, moved(a, b, meetings))
    centre = densest(points_a, after)
    panels = [panel(points_a, points_b, centre, text) for points_b, text in ((before, "before"), (after, "after"))]
    image = np.concatenate([panels[0], np.full((panels[0].shape[0], 6, 3), 255, np.uint8), panels[1]], axis=1)
    file.write_bytes(cv2.imencode(".jpg", np.ascontiguousarray(image[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())


def moved(a: PlacedDrive, b: PlacedDrive, meetings: tuple[Meeting, ...]) -> list[FloatArray]:
    """T_enu_submap of b's submaps: by the surest meeting of each, those without one with the nearest that has."""
    best: dict[int, Meeting] = {}
    for m in meetings:
        if m.submap_b not in best or np.trace(m.covariance) < np.trace(best[m.submap_b].covariance):
            best[m.submap_b] = m
    out = []
    for s, item in enumerate(b.submaps):
        m = best[min(best, key=lambda k: abs(k - s))]
        T = a.submaps[m.submap_a].T_enu_submap @ m.T_a_b
        out.append(T @ se3.inverse(b.submaps[m.submap_b].T_enu_submap) @ item.T_enu_submap)
    return out


def upright(drive: PlacedDrive, T_enu_submap: list[FloatArray]) -> FloatArray:
    """(N, 3) m: points of things that stand upright, of a useful certainty."""
    parts = []
    for item, T in zip(drive.submaps, T_enu_submap, strict=True):
        submap = item.submap
        ground = float(np.median(submap.T_submap_cam[:, 1, 3])) + 1.65
        height = ground - submap.xyz[:, 1]
        kept = np.isin(submap.label, UPRIGHT) & (height > LOW_M) & (height < HIGH_M) & (submap.variance < 0.15**2)
        parts.append(se3.transform(T, submap.xyz[kept].astype(np.float64)))
    return np.concatenate(parts)


def densest(one: FloatArray, other: FloatArray) -> FloatArray:
    """(2,) m: centre of the square where both have most points."""
    low = np.minimum(one[:, :2].min(axis=0), other[:, :2].min(axis=0))
    step = SIDE_M / 4
    shape = tuple((np.maximum(one[:, :2].max(axis=0), other[:, :2].max(axis=0)) - low) // step + 1)
    counts = []
    for points in (one, other):
        cells = ((points[:, :2] - low) // step).astype(np.int64)
        count = np.zeros([int(n) for n in shape], np.float32)
        np.add.at(count, tuple(cells.T), 1.0)
        counts.append(cv2.boxFilter(count, -1, (4, 4), normalize=False, borderType=cv2.BORDER_CONSTANT))
    i, j = np.unravel_index(int(np.argmax(np.minimum(*counts))), counts[0].shape)
    return low + step * np.array([i, j])


def panel(points_a: FloatArray, points_b: FloatArray, centre: FloatArray, text: str) -> NDArray[np.uint8]:
    """(h, w, 3) RGB from above, north up."""
    side = int(SIDE_M * PX_PER_M)
    light = np.zeros((side, side, 3), np.float32)
    for points, colour in ((points_a, COLOURS[0]), (points_b, COLOURS[1])):
        uv = ((points[:, :2] - centre) * PX_PER_M + side / 2).astype(np.int64)
        inside = ((uv >= 0) & (uv < side)).all(axis=1)
        ink = np.zeros((side, side), np.float32)
        np.add.at(ink, (side - 1 - uv[inside, 1], uv[inside, 0]), 1.0)
        ink = np.minimum(cv2.GaussianBlur(ink, (0, 0), 1.1) * 5.0, 1.0)
        light += ink[:, :, None] * (255.0 - np.array(colour, np.float32))
    image = np.clip(255.0 - light, 0, 255).astype(np.uint8)
    head = np.full((BAR_PX, side, 3), 255, np.uint8)
    cv2.putText(head, text, (8, BAR_PX - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (30, 30, 30), 1, cv2.LINE_AA)
    cv2.line(head, (side - 10 - 5 * PX_PER_M, BAR_PX - 12), (side - 10, BAR_PX - 12), (30, 30, 30), 2)
    cv2.putText(head, "5 m", (side - 60 - 5 * PX_PER_M, BAR_PX - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA)
    return np.concatenate([head, image])
