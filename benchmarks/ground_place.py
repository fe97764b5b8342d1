"""Orthophotos of a real drive over the place that its GNSS gives them; the table of docs/benchmarks/ground.md.

    python benchmarks/ground_place.py OUT OXTS [--write place]

OUT is what `wayloom process` left of a drive with GNSS, OXTS its KITTI …_sync folder with a packet a frame. There is no aerial
picture to compare with. What can be told: how the receiver lies to the camera, submap by submap, against the calibration's
lever arm; how high camera and receiver are over the sheet's own ground below them; and by how much the orthophotos of
neighbouring submaps, each placed by its own pose, are shifted where both show the ground (normalised correlation of squares
of 4 m).
"""

import argparse
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from pages import DOCS, put_between_marks
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.sheet import CELL_M, PIXEL_M, GroundSheet
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap

PAGE = DOCS / "benchmarks" / "ground.md"
AROUND_M = 25.0
SQUARE_PX, SEARCH_PX = 80, 16
DETAIL_PX = 41
SHARP_PX_M = 3
LEAST_SEEN, LEAST_CONTRAST, LEAST_CORRELATION = 0.8, 3.0, 0.5


@dataclass(frozen=True)
class Laid:
    """A sheet and its place: T_enu_sheet (4, 4); T_enu_cam (K, 4, 4) of its submap's keyframes."""

    sheet: GroundSheet
    T_enu_sheet: np.ndarray
    T_enu_cam: np.ndarray
    frames: np.ndarray

    def at(self, xy: np.ndarray) -> np.ndarray:
        """(N, 2) x and y in the sheet's frame of places (N, 2) m east and north, on its level."""
        level = np.full((len(xy), 1), self.T_enu_sheet[2, 3])
        return se3.transform(se3.inverse(self.T_enu_sheet), np.hstack([xy, level]))[:, :2]

    def over_ground(self, points: np.ndarray) -> np.ndarray:
        """(M,) m of points (N, 3) ENU over the sheet's surface, those that have one below."""
        at = self.at(points[:, :2])
        column, row = np.floor(at / CELL_M).astype(int).T - self.sheet.corner[:, None]
        inside = (row >= 0) & (column >= 0) & (row < self.sheet.height.shape[0]) & (column < self.sheet.height.shape[1])
        height = self.sheet.height[row[inside], column[inside]]
        known = np.isfinite(height)
        on_ground = se3.transform(self.T_enu_sheet, np.column_stack([at[inside][known], height[known]]))
        return points[inside, 2][known] - on_ground[:, 2]

    def rasters(self, low: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Grey, sharpness and height (m, NaN) at pixels of 5 cm from `low` on, m east and north."""
        row, column = np.indices(shape)
        at = self.at(low + (np.column_stack([column.ravel(), row.ravel()]) + 0.5) * PIXEL_M)
        fine, coarse = (((at / size - k * self.sheet.corner - 0.5).astype(np.float32)) for size, k in ((PIXEL_M, 2), (CELL_M, 1)))
        u, v, c, r = (one.reshape(shape) for one in (*fine.T, *coarse.T))
        grey = cv2.remap(self.sheet.colour.mean(axis=2).astype(np.float32), u, v, cv2.INTER_LINEAR)
        sharp = cv2.remap(self.sheet.sharpness, u, v, cv2.INTER_NEAREST)
        height = cv2.remap(self.sheet.height.astype(np.float32), c, r, cv2.INTER_NEAREST, borderValue=float("nan"))
        return grey, sharp, height + np.float32(self.T_enu_sheet[2, 3])


def laid_sheets(out: Path) -> tuple[list[Laid], list[PlacedSubmap]]:
    """The sheets of a drive, in the order of the road."""
    submaps, index = load_submaps(out / "stages" / "submaps"), read_index(out / "stages" / "ground")
    laid = []
    for item in submaps:
        if item.submap.digest in index:
            sheet = load_sheet(out / "stages" / "ground", index[item.submap.digest])
            T_enu_cam = item.T_enu_submap @ item.submap.T_submap_cam
            laid.append(Laid(sheet, item.T_enu_submap @ sheet.T_submap_sheet, T_enu_cam, item.submap.keyframe_frame))
    return laid, submaps


def shifts(one: Laid, other: Laid) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) m east and north by which the second orthophoto lies off the first, a square each, and heights (m) apart."""
    cameras = np.concatenate([one.T_enu_cam, other.T_enu_cam])[:, :2, 3]
    low, high = cameras.min(axis=0) - AROUND_M, cameras.max(axis=0) + AROUND_M
    columns, rows = np.ceil((high - low) / PIXEL_M).astype(int).tolist()
    (grey, sharp, height), (grey_2, sharp_2, height_2) = (item.rasters(low, (rows, columns)) for item in (one, other))
    both = ((sharp > SHARP_PX_M) & (sharp_2 > SHARP_PX_M)).astype(np.float32)
    size = (DETAIL_PX, DETAIL_PX)
    detail, detail_2 = ((g - cv2.blur(g * both, size) / np.maximum(cv2.blur(both, size), 0.01)) * both for g in (grey, grey_2))
    found = []
    for r in range(0, rows - SQUARE_PX, SQUARE_PX // 2):
        for c in range(0, columns - SQUARE_PX, SQUARE_PX // 2):
            square = (slice(r, r + SQUARE_PX), slice(c, c + SQUARE_PX))
            core = detail[square][SEARCH_PX:-SEARCH_PX, SEARCH_PX:-SEARCH_PX]
            if both[square].mean() < LEAST_SEEN or core.std() < LEAST_CONTRAST:
                continue
            _, most, _, place = cv2.minMaxLoc(cv2.matchTemplate(detail_2[square], core, cv2.TM_CCOEFF_NORMED))
            if most > LEAST_CORRELATION:
                found.append((np.array(place) - SEARCH_PX) * PIXEL_M)
    apart = (height_2 - height)[both > 0.0]
    return np.array(found).reshape(-1, 2), apart[np.isfinite(apart)]


def table(out: Path, oxts: Path) -> str:
    """Markdown table, a row a submap and one a pair of neighbours."""
    laid, submaps = laid_sheets(out)
    packets = np.array([np.loadtxt(file)[:3] for file in sorted((oxts / "oxts" / "data").glob("*.txt"))])
    receiver = wgs84.enu_from_lonlatheight(packets[:, [1, 0, 2]], submaps[0].frame)
    lines = [
        "| submap | receiver right, down, ahead of the camera (m): median | scatter about it (cm) |"
        " camera over ground, receiver over ground (m): median; nine in ten within (cm) |",
        "| --- | --- | --- | --- |",
    ]
    for number, one in enumerate(laid, 1):
        cameras, fixes = one.T_enu_cam[:, :3, 3], receiver[one.frames]
        in_camera = np.einsum("nji,nj->ni", one.T_enu_cam[:, :3, :3], fixes - cameras)
        told = []
        for points in (cameras, fixes):
            height = one.over_ground(points)
            middle = float(np.median(height))
            told.append(f"{middle:.2f}; {100 * np.percentile(np.abs(height - middle), 90):.1f}")
        lever, scatter = (", ".join(f"{value:{form}}" for value in values) for values, form in (
            (np.median(in_camera, axis=0), "+.2f"), (100 * in_camera.std(axis=0), ".0f"),
        ))  # fmt: skip
        lines.append(f"| {number} | {lever} | {scatter} | {', '.join(told)} |")
    lines += ["", "| neighbours | squares | shift east, north (cm): median | size: median, p90 | heights apart: median, p95 (mm) |",
              "| --- | --- | --- | --- | --- |"]  # fmt: skip
    for number, (one, other) in enumerate(pairwise(laid), 1):
        found, apart = shifts(one, other)
        if not len(found):
            continue
        size = np.percentile(100 * np.linalg.norm(found, axis=1), (50, 90))
        east, north = 100 * np.median(found, axis=0)
        off = 1000 * np.abs(apart - np.median(apart))
        lines.append(
            f"| {number}, {number + 1} | {len(found)} | {east:+.0f}, {north:+.0f} | {size[0]:.0f}, {size[1]:.0f} |"
            f" {1000 * np.median(apart):+.0f}, {np.percentile(off, 95):.0f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, and write where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("oxts", type=Path)
    parser.add_argument("--write", metavar="NAME")
    asked = parser.parse_args()
    text = table(asked.out, asked.oxts)
    print(text)
    if asked.write:
        put_between_marks(PAGE, asked.write, text)


if __name__ == "__main__":
    main()
