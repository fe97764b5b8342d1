"""CPU seconds of a region's ground, of its tiles and of one more drive, and how much faster the painting is than its naive twin.

    python benchmarks/ground_map.py [--drives 8] [--write]
    python benchmarks/ground_map.py --sheets PROCESSED:SHEETS …
    python benchmarks/ground_map.py --light [--write]

The street is made (`tests/ground/made_sheets.py`). With --sheets, of drives that `wayloom process` has processed, and folders of
their sheets: the same, of the regions that they reach. With --light, two drives past the same places of the simulated city in
different weather, their sheets rendered from above: what of the newer one's light the map shows, and how its patches meet. --write
puts the tables of the made street and of light into docs/benchmarks/ground_map.md.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

from pages import DOCS, put_between_marks

sys.path.pop(0)  # this folder, whose ground.py hides the tests' folder of that name
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "tiles"))

import cv2
import numpy as np
from test_ground_tiles import Held

from ground.made_sheets import SURE, Street, cut
from ground.test_merge import painted_naively
from wayloom.evaluation.made_ground import Wear, made_sheet, worn
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.exposure import WHITE_PERCENTILE, DriveExposure
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.ground_map import GroundMap
from wayloom.ground.kernels import merging
from wayloom.ground.merge import TILE_M, merge_sheets
from wayloom.ground.placed_sheet import PlacedSheet, kernel_arrays, reach
from wayloom.ground.sheet import GroundSheet
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import WEATHERS
from wayloom.stitching.region_grid import REGION_M, region_edges, regions_within
from wayloom.submaps.files import load_submaps
from wayloom.tiles.ground_tiles import ground_tiles
from wayloom.tiles.settings import TileSettings

PAGE: Final = DOCS / "benchmarks" / "ground_map.md"
STREET: Final = Street()
FRAME: Final = MapFrame(8.4, 49.0, 100.0)
LIGHTS: Final = (("clear", "clear"), ("clear", "low sun"), ("low sun", "clear"), ("clear", "wet road"), ("overcast", "noon"))
"""Weathers of an older and a newer drive."""
SHADOWLESS: Final = "overcast"
HALF_M: Final = 60.0
"""Sheets reach so far beyond both sides of the measured region."""


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--sheets", nargs="*", default=[])
    parser.add_argument("--light", action="store_true")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.light:
        table = light()
        print(table)
        if options.write:
            put_between_marks(PAGE, "light", table)
        return
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
            level = np.ones((wanted.shape[0] + 2, wanted.shape[1] + 2, 3))
            merging.paint(held, 1, wanted, at, field, first, level, out)

        return shape[0] * shape[1] / seconds(run)

    paint(few, corner)
    compiled = paint(many, np.array([1, 28]))
    naive = few.size * 256 / seconds(lambda: painted_naively(sheet, 1, few, corner, field, first, np.ones((4, 4, 3))))
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


def light() -> str:
    """Markdown table: of two drives in two weathers over the places of a city, what the merged ground shows."""
    made = {name: light_sheets(name) for name in {*itertools.chain(*LIGHTS), SHADOWLESS}}
    lines = [
        "| older drive | newer drive | shown by the newer (%) | patches | steps at their borders, elsewhere: median, p90, p99 |"
        " 80 cm darker than the ground: newer, map (%) |",
        "| --- | --- | ---: | ---: | --- | --- |",
    ]
    for older, newer in LIGHTS:
        shown, patches, at_borders, elsewhere, dark = [], 0, [], [], []
        for k, plain in enumerate(made[SHADOWLESS]):
            first = worn_drive(made[older][k], "a", 100, k, -1.5, (0.0, 0.0, 0.0))
            second = worn_drive(made[newer][k], "b", 9000, 50 + k, 1.5, (0.03, 0.04, 0.01))
            low = np.round((plain.T_submap_sheet[:2, 3] - REGION_M / 2.0) / TILE_M) * TILE_M
            both, alone, ground = (
                merge_sheets(drives, low, REGION_M) for drives in ([first, second], [second], [placed(plain, "c", 1)])
            )
            assert both is not None
            assert alone is not None
            assert ground is not None
            is_newer = np.array([drive_id[0] == "b" for drive_id, _ in ((" ", ""), *both.sheets)])[both.shown]
            shown.append(is_newer[both.shown > 0].mean())
            patches += sum(
                cv2.connectedComponents(mask.astype(np.uint8))[0] - 1 for mask in (is_newer, ~is_newer & (both.shown > 0))
            )
            for at_border, steps in border_steps(both):
                (at_borders if at_border else elsewhere).append(steps)
            dark.append([darker(one, ground) for one in (alone, both)])
        told = [", ".join(f"{v:.1f}" for v in np.percentile(np.concatenate(one), (50, 90, 99))) for one in (at_borders, elsewhere)]
        of_newer, of_map = 100.0 * np.mean(dark, axis=0)
        lines.append(
            f"| {older} | {newer} | {100 * np.mean(shown):.0f} | {patches} | {told[0]}; {told[1]} | {of_newer:.1f}, {of_map:.1f} |"
        )
    return "\n".join(lines) + "\n"


def light_sheets(weather: str) -> list[GroundSheet]:
    """The true ground at the places, 80 m by 40 m, in the tones that a drive's orthophoto has."""
    world = build_world(CitySettings(seed=3), WEATHERS[weather].model_copy(update={"haze_per_m": 0.0}), "half")
    nodes, sheets = world.city.graph.nodes, []
    for place in (nodes[12], (nodes[6] + nodes[7]) / 2, (nodes[12] + nodes[13]) / 2):
        sheet = made_sheet(world, (float(place[0]), float(place[1])), (80.0, 40.0))
        white = float(np.percentile(sheet.colour[sheet.sharpness > 0], WHITE_PERCENTILE))
        tone = DriveExposure(np.ones(1), np.zeros(1), white, 0.0).tone(sheet.colour)
        sheets.append(replace(sheet, colour=np.rint(tone).clip(0, 255).astype(np.uint8)))
    return sheets


def worn_drive(
    true: GroundSheet, drive_id: str, t_s: int, seed: int, track_y_m: float, off_m: tuple[float, float, float]
) -> PlacedSheet:
    """A drive past the place, off_m from where it believes to be, its sheet as images of half size leave it."""
    return placed(worn(true, Wear(near_px_m=12.0, far_px_m=3.0, track_y_m=track_y_m, seed=seed)), drive_id, t_s, off_m)


def placed(sheet: GroundSheet, drive_id: str, t_s: int, off_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> PlacedSheet:
    """The sheet of a drive, whose own frame is the city's."""
    dated = replace(sheet, t_ns=np.array([t_s, t_s + 10], np.int64) * 1_000_000_000)
    T = np.eye(4)
    T[:3, 3] = off_m
    return PlacedSheet(64 * drive_id, dated.digest, lambda: dated, T, SURE)


def border_steps(made: GroundMap) -> Iterator[tuple[bool, np.ndarray]]:
    """Steps of grey between means of 25 cm, along both axes, where another sheet begins to show and where none does."""
    size, gap = 5, 2
    mean = cv2.blur(made.colour.astype(np.float32).mean(axis=2), (size, size))
    whole = cv2.erode((made.shown > 0).astype(np.uint8), np.ones((2 * size + 1, 2 * size + 1), np.uint8)) > 0
    for grey, known, shown in ((mean, whole, made.shown), (mean.T, whole.T, made.shown.T)):
        step, width = np.abs(grey[:, size:] - grey[:, :-size]), grey.shape[1] - size
        at_border = shown[:, gap : gap + width] != shown[:, gap + 1 : gap + 1 + width]
        inside = known[:, size:] & known[:, :-size]
        for border in (True, False):
            yield border, step[inside & (at_border == border)]


def darker(made: GroundMap, ground: GroundMap) -> float:
    """Share of the squares of 80 cm that are darker than the shadowless ground by a fifth, brought to one median."""
    edge = 16

    def squares(one: GroundMap) -> np.ndarray:
        grey = np.where(made.shown > 0, one.colour.astype(np.float64).mean(axis=2), np.nan)
        n = len(grey) // edge
        return np.asarray(grey.reshape(n, edge, n, edge).mean(axis=(1, 3)))

    share = squares(made) / squares(ground)
    share = share[np.isfinite(share)]
    return float(np.mean(share < 0.8 * np.median(share)))


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
