"""CPU seconds of a region's ground, of its tiles and of one more drive, and how much faster the painting is than its naive twin.

    python benchmarks/ground_map.py [--drives 8] [--write]
    python benchmarks/ground_map.py --sheets PROCESSED:SHEETS …

The street is made (`tests/ground/made_sheets.py`). With --sheets, of drives that `wayloom process` has processed, and folders of
their sheets: the same, of the regions that they reach. --write puts the table of the made street into
docs/benchmarks/ground_map.md.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "tiles"))

import numpy as np
from test_ground_tiles import Held

from ground.made_sheets import Street, cut
from ground.test_merge import painted_naively
from pages import DOCS, put_between_marks
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.kernels import merging
from wayloom.ground.merge import merge_sheets
from wayloom.ground.placed_sheet import PlacedSheet, kernel_arrays, reach
from wayloom.stitching.region_grid import REGION_M, region_edges, regions_within
from wayloom.submaps.files import load_submaps
from wayloom.tiles.ground_tiles import ground_tiles
from wayloom.tiles.settings import TileSettings

PAGE: Final = DOCS / "benchmarks" / "ground_map.md"
STREET: Final = Street()
FRAME: Final = MapFrame(8.4, 49.0, 100.0)
HALF_M: Final = 60.0
"""Sheets reach so far beyond both sides of the measured region."""


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--sheets", nargs="*", default=[])
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.sheets:
        real_regions(options.sheets)
        return
    lines = [
        "| drives in the region | sheets | merge, CPU s | packed, CPU s | MB | tiles, CPU s | tiles | MB |",
        "| ---: " * 8 + "|",
    ]
    count = 1
    while count <= options.drives:
        lines.append(row_of(count))
        print(lines[-1], flush=True)
        count *= 2
    lines += ["", twin()]
    print(lines[-1])
    if options.write:
        put_between_marks(PAGE, "ground_map", "\n".join(lines))


def made_drive(number: int) -> list[PlacedSheet]:
    """Sheets of 42 m past the region, every second drive in the other direction."""
    starts = np.arange(-HALF_M, REGION_M + HALF_M, 40.0).tolist()
    way = {"yaw": 0.2 + 3.1 * (number % 2), "gain": 0.8 + 0.05 * (number % 5), "t_s": 1000 * number}
    return [cut(STREET, x, x + 42.0, f"{number:064x}", seed=100 * number + k, **way) for k, x in enumerate(starts)]  # type: ignore[arg-type]


def row_of(drives: int) -> str:
    """One row of the table: best of three runs."""
    sheets = [sheet for number in range(drives) for sheet in made_drive(number)]
    made = merge_sheets(sheets, np.zeros(2), REGION_M)
    assert made is not None
    merge_s = seconds(lambda: merge_sheets(sheets, np.zeros(2), REGION_M))
    packed, pack_s = made.encoded(), seconds(made.encoded)
    source = Held({(0, 0): made})
    tiles = list(ground_tiles([(0, 0)], source, FRAME, TileSettings()))
    tiles_s = seconds(lambda: list(ground_tiles([(0, 0)], source, FRAME, TileSettings())))
    size = sum(len(tile.data) for tile in tiles)
    cells = [drives, len(made.sheets), f"{merge_s:.2f}", f"{pack_s:.2f}", f"{len(packed) / 1e6:.2f}", f"{tiles_s:.2f}", len(tiles)]
    return "| " + " | ".join(map(str, [*cells, f"{size / 1e6:.2f}"])) + " |"


def twin() -> str:
    """The kernel that paints beside a plain loop."""
    sheet = made_drive(0)[1]
    held, field = kernel_arrays(sheet.read(), sheet.T_map_submap), np.ones((4, 6, 6))
    corner, first = np.array([1, 36]), np.array([-2, 7])
    few, many = np.ones((2, 2), np.bool_), np.ones((20, 24), np.bool_)

    def paint(wanted: np.ndarray, at: np.ndarray) -> float:
        shape = (16 * wanted.shape[0], 16 * wanted.shape[1])

        def run() -> None:
            out = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint8), np.zeros(shape, np.uint16)
            merging.paint(held, 1, wanted, at, field, first, out)

        return shape[0] * shape[1] / seconds(run)

    paint(few, corner)
    compiled = paint(many, np.array([1, 28]))
    naive = few.size * 256 / seconds(lambda: painted_naively(sheet, 1, few, corner, field, first))
    return f"Painting: {compiled / 1e6:.1f} million pixels a second, {compiled / naive:.0f} times the naive twin of the tests."


def real_regions(folders: Sequence[str]) -> None:
    """CPU of the regions that real sheets reach."""
    sheets: list[PlacedSheet] = []
    for pair in folders:
        processed, folder = map(Path, pair.split(":"))
        index, read = read_index(folder), lru_cache(64)(load_sheet)
        for item in load_submaps(processed / "stages" / "submaps"):
            digest = index.get(item.submap.digest)
            if digest is not None:
                get = partial(read, folder, digest)
                sheets.append(PlacedSheet(item.drive_id, digest, get, item.T_enu_submap, item.covariance))
    boxes = [reach(one.read(), one.T_map_submap) for one in sheets]
    keys = sorted({key for low, high in boxes for key in regions_within(low, high, 0.0)})
    start = time.process_time()
    made = {key: merge_sheets(sheets, region_edges(key)[0], REGION_M) for key in keys}
    merge_s = time.process_time() - start
    held = {key: one for key, one in made.items() if one is not None}
    size = sum(len(one.encoded()) for one in held.values())
    print(
        f"{len(sheets)} sheets, {len(held)} regions: {merge_s:.1f} CPU s, {merge_s / len(held):.2f} a region, {size / 1e6:.1f} MB"
    )


def seconds(work: Callable[[], object]) -> float:
    """CPU time of the best of three runs."""
    times = []
    for _ in range(3):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


if __name__ == "__main__":
    main()
