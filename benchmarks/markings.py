"""Markings and kerbs measured.

python benchmarks/markings.py drives OUT LOG [OUT LOG ...]   OUT of `wayloom process`, LOG simulated with --truth
python benchmarks/markings.py made [--seed N]                made sheets: the city's true ground, blurred and noisy
python benchmarks/markings.py straight OUT [--picture FILE]  a real drive: how straight its rows of dashes are, and a picture
python benchmarks/markings.py map OUT [OUT ...]              the merged ground of drives beside what each finds by itself

--sheets DIR: take the sheets of that folder instead of OUT's own, for `map` once for each OUT.
--write NAME: the table into docs/benchmarks/markings.md.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pages import DOCS, put_between_marks
from wayloom.evaluation.made_ground import Wear, made_sheet
from wayloom.evaluation.markings import Scores, score_kerbs, score_markings
from wayloom.exports.drive_outputs import MergedSheets
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.rigid import mean_motion
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.markings.exports import geojson, markings_of_drive
from wayloom.ground.markings.find import find_markings
from wayloom.ground.markings.kerbs import find_kerbs
from wayloom.ground.markings.raster import raster_of_sheet
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.markings.types import Kerb, Marking
from wayloom.ground.placed_sheet import PlacedSheet
from wayloom.ground.sheet import PIXEL_M, GroundSheet
from wayloom.logs.simulated_truth import open_truth
from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.objects import Area
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import LightSettings
from wayloom.stitching.marking_files import lines_of, read_features
from wayloom.stitching.region_markings import region_markings
from wayloom.submaps.files import load_submaps

FloatArray = NDArray[np.float64]
PAGE = DOCS / "benchmarks" / "markings.md"
AROUND_M = 60.0
COLOURS = {
    "dash": (0, 255, 0), "solid": (255, 128, 0), "stop_line": (255, 0, 255), "zebra": (0, 255, 255), "arrow": (0, 0, 255),
    "symbol": (0, 128, 255),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("drives", "made", "straight", "map"))
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--sheets", type=Path, action="append")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--write")
    options = parser.parse_intermixed_args()
    first = options.sheets[0] if options.sheets else None
    if options.what == "map":
        table = of_map(options.paths, options.sheets or [out / "stages" / "ground" for out in options.paths])
    elif options.what == "straight":
        table = straight(options.paths[0], first, options.picture)
    elif options.what == "made":
        table = as_table(made(options.seed))
    else:
        table = as_table(drives(list(zip(options.paths[::2], options.paths[1::2], strict=True)), first))
    print(table)
    if options.write:
        put_between_marks(PAGE, options.write, table)


class Run:
    """Sums over sheets, with the time taken and the road covered."""

    def __init__(self) -> None:
        self.scores, self.markings_s, self.kerbs_s, self.road_m = Scores(), 0.0, 0.0, 0.0
        self.settings, self.kerb_settings = MarkingSettings(), KerbSettings()

    def add(self, sheet: GroundSheet, T_enu_sheet: FloatArray, city: City, road_m: float) -> None:
        """Find, time and score one sheet."""
        raster = raster_of_sheet(sheet)
        start = time.process_time()
        found = find_markings(raster, self.settings)
        middle = time.process_time()
        kerbs = find_kerbs(raster, self.kerb_settings)
        self.kerbs_s += time.process_time() - middle
        self.markings_s += middle - start
        self.road_m += road_m
        area = _area(sheet, T_enu_sheet)
        T = se3.inverse(T_enu_sheet)
        score_markings(self.scores, found, city.markings(area), raster, T, self.settings)
        score_kerbs(self.scores, kerbs, city.kerbs(area), raster, T)


def _area(sheet: GroundSheet, T_enu_sheet: FloatArray) -> Area:
    rows, columns = sheet.sharpness.shape
    corners = sheet.corner_m + PIXEL_M * np.array([(x, y) for x in (0, columns) for y in (0, rows)])
    enu = corners @ T_enu_sheet[:2, :2].T + T_enu_sheet[:2, 3]
    low, high = enu.min(axis=0), enu.max(axis=0)
    return Area((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))


def drives(pairs: Sequence[tuple[Path, Path]], sheets: Path | None) -> Run:
    """Sheets of processed drives, placed by the true poses of their keyframes: errors are those within a sheet."""
    run = Run()
    for out, log in pairs:
        preset = json.loads((log.parent / "simulation.json").read_text())["preset"]
        city = build_city(CitySettings(**preset["city"]), Models())
        truth = open_truth(log).T_enu_cam
        folder = sheets or out / "stages" / "ground"
        submaps = {item.submap.digest: item.submap for item in load_submaps(out / "stages" / "submaps")}
        warm = True
        for submap, digest in read_index(folder).items():
            sheet, own = load_sheet(folder, digest), submaps[submap]
            if warm:
                find_markings(raster_of_sheet(sheet))  # compiles the kernels
                find_kerbs(raster_of_sheet(sheet))
                warm = False
            T_enu_submap = mean_motion(truth[own.keyframe_frame] @ se3.inverse(own.T_submap_cam))
            run.add(sheet, T_enu_submap @ sheet.T_submap_sheet, city, own.length_m)
    return run


def of_map(outs: Sequence[Path], folders: Sequence[Path]) -> str:
    """What each drive finds by itself and what is found on the merged ground of all, as Markdown."""
    columns, placed, frame = {}, [], None
    for number, (out, folder) in enumerate(zip(outs, folders, strict=True), 1):
        submaps = load_submaps(out / "stages" / "submaps")
        index = read_index(folder)
        read = lru_cache(48)(load_sheet)
        placed += [
            PlacedSheet(
                str(number),
                index[one.submap.digest],
                partial(read, folder, index[one.submap.digest]),
                one.T_enu_submap,
                one.covariance,
            )
            for one in submaps
            if one.submap.digest in index
        ]
        found = markings_of_drive(folder, submaps, MarkingSettings(), KerbSettings())
        frame = _one_frame(frame, submaps[0].frame, out)
        columns[f"drive {number}"] = geojson(*found, frame, submaps)["features"]
    assert frame is not None
    ground, found_of_map, seconds = MergedSheets(placed), [], []
    for key in ground.keys:
        start = time.process_time()
        data = region_markings(key, ground, frame, MarkingSettings(), KerbSettings())
        seconds.append(time.process_time() - start)
        found_of_map += [] if data is None else read_features(data)
    columns["map"] = found_of_map
    told = {name: _of_features(found, frame) for name, found in columns.items()}
    head = f"| | {' | '.join(columns)} |\n| --- |{' --- |' * len(columns)}\n"
    rows = "".join(f"| {row} | {' | '.join(one[row] for one in told.values())} |\n" for row in told["map"])
    about = (
        f"{len(placed)} sheets, {len(ground.keys)} regions: {np.mean(seconds):.2f} s of CPU a region, at most {max(seconds):.2f} s"
    )
    return f"{head}{rows}\n{about}"


def _one_frame(of_others: MapFrame | None, own: MapFrame | None, out: Path) -> MapFrame:
    """The frame of a drive, which has to be that of the drives before."""
    if own is None:
        sys.exit(f"{out}: has no place on Earth. Process the log with its GNSS.")
    if of_others is not None and own != of_others:
        sys.exit(f"{out}: lies in another map frame than the drives before. Give drives of one degree cell.")
    return own


def _of_features(found: Sequence[dict[str, Any]], frame: MapFrame) -> dict[str, str]:
    """Numbers, lengths, widths, and how many lines have another one's middle within 30 cm of theirs."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for one in found:
        kinds.setdefault(one["properties"]["kind"], []).append(one["properties"])
    rows = {
        f"{kind}, number and length": f"{len(kinds.get(kind, []))}, {sum(one['length_m'] for one in kinds.get(kind, [])):.0f} m"
        for kind in ("dash", "solid", "stop_line", "zebra", "symbol", "kerb")
    }
    lines = [one for one in found if one["properties"]["kind"] in ("dash", "solid", "stop_line")]
    ends = [np.array(lines_of(one["geometry"])[0]) for one in lines]
    middles = np.array([wgs84.enu_from_lonlatheight(line, frame)[[0, -1], :2].mean(axis=0) for line in ends]).reshape(-1, 2)
    gaps = np.hypot(*(middles[:, None] - middles[None]).transpose(2, 0, 1)) + 1e3 * np.eye(len(middles))
    widths = [one["width_m"] for one in kinds.get("dash", [])]
    rows["width of dashes, median"] = f"{100 * np.median(widths):.1f} cm" if widths else "–"
    rows["lines with another's middle within 30 cm"] = str(int((gaps.min(axis=1, initial=1e3) < 0.3).sum()))
    heights = [one["height_m"] for one in kinds.get("kerb", [])]
    rows["height of kerbs, median"] = f"{100 * np.median(heights):.1f} cm" if heights else "–"
    return rows


def made(seed: int) -> Run:
    """Sheets of 80 x 40 m around crossings and streets of a city, worn as `Wear` says."""
    run = Run()
    world = build_world(CitySettings(seed=seed), LightSettings(haze_per_m=0.0), "half")
    nodes = world.city.graph.nodes
    places = [nodes[12], (nodes[6] + nodes[7]) / 2, (nodes[12] + nodes[13]) / 2, (nodes[16] + nodes[17]) / 2]
    for number, place in enumerate(places):
        wear = Wear(unseen_share=0.04, track_y_m=-1.5, seed=number, near_px_m=12.0, far_px_m=3.0)
        sheet = made_sheet(world, (float(place[0]), float(place[1])), (80.0, 40.0), wear)
        if number == 0:
            find_markings(raster_of_sheet(sheet))
            find_kerbs(raster_of_sheet(sheet))
        run.add(sheet, sheet.T_submap_sheet, world.city, 80.0)
    return run


def as_table(run: Run) -> str:
    """The scores as Markdown."""
    s = run.scores
    rows = [
        ("lines found", f"{s.found:.0f} m"),
        ("of them on true lines (precision)", percent(s.true, s.found)),
        *((f"true {kind} seen, found (recall)", f"{s.seen[kind]:.0f} m, {percent(s.hit[kind], s.seen[kind])}") for kind in s.seen),
        ("position across, median and p95", centimetres(s.across)),
        ("width, median error and p90", f"{100 * np.median(s.width):+.1f} cm, {100 * np.percentile(np.abs(s.width), 90):.1f} cm"),
        ("ends of dashes along, median and p90", centimetres(np.abs(s.ends), 90)),
        ("error across over its sigma, rms", f"{rms(s.ratio):.2f}"),
    ]
    for kind, (found, true, seen, hit) in sorted(s.count.items()):
        rows.append((f"{kind}: found, true of them; seen, found of them", f"{found}, {true}; {seen}, {hit}"))
    if s.bars:
        rows.append(("bars' width, median error", f"{100 * np.median(s.bars):+.1f} cm"))
    rows += [
        ("kerbs found", f"{s.kerb_found:.0f} m"),
        ("of them on true kerbs (precision)", percent(s.kerb_true, s.kerb_found)),
        ("true kerbs with heights on both sides, found (recall)", f"{s.kerb_seen:.0f} m, {percent(s.kerb_hit, s.kerb_seen)}"),
        ("kerb position, median and p95", centimetres(s.kerb_across)),
        ("kerb height (12 cm), median error, p90 of its size", height(s.kerb_height)),
        ("kerb height error over its sigma, rms", f"{rms(s.height_ratio):.2f}"),
        (
            "CPU a metre of road, markings and kerbs",
            f"{1000 * run.markings_s / run.road_m:.1f} ms, {1000 * run.kerbs_s / run.road_m:.1f} ms",
        ),
    ]
    return "\n".join(["| measure | value |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)])


def percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "–"


def centimetres(errors: Sequence[float] | FloatArray, high: int = 95) -> str:
    return f"{100 * np.median(errors):.1f} cm, {100 * np.percentile(errors, high):.1f} cm" if len(errors) else "–"


def height(errors: Sequence[float]) -> str:
    return f"{100 * np.median(errors):+.1f} cm, {100 * np.percentile(np.abs(errors), 90):.1f} cm" if len(errors) else "–"


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def straight(out: Path, sheets: Path | None, picture: Path | None) -> str:
    """Residuals of the dashes' middles and ends about the straight line of each row of at least three within 10 m."""
    folder = sheets or out / "stages" / "ground"
    rows = [
        "| row | dashes | length | width, median | middles about the line, rms | ends about the line, most |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for digest in read_index(folder).values():
        sheet = load_sheet(folder, digest)
        raster = raster_of_sheet(sheet)
        found, kerbs = find_markings(raster), find_kerbs(raster)
        for number, row in enumerate(_rows([one for one in found if one.kind in ("dash", "solid")]), start=1):
            ends = np.concatenate([one.line[:, :2] for one in row])
            middle = ends.mean(axis=0)
            d = np.linalg.svd(ends - middle)[2][0]
            aside, along = (ends - middle) @ np.array([-d[1], d[0]]), (ends - middle) @ d
            middles = [((one.line[:, :2].mean(axis=0) - middle) @ np.array([-d[1], d[0]])) for one in row]
            rows.append(
                f"| {number} | {len(row)} | {np.ptp(along):.1f} m | {100 * np.median([one.width_m for one in row]):.0f} cm "
                f"| {100 * rms(middles):.1f} cm | {100 * np.abs(aside).max():.1f} cm |"
            )
        if picture is not None:
            cv2.imwrite(str(picture), drawn(sheet, found, kerbs), [cv2.IMWRITE_JPEG_QUALITY, 85])
            break
    return "\n".join(rows)


def _rows(lines: list[Marking]) -> list[list[Marking]]:
    """Groups of three and more lines that follow one another within 3 m, along the same direction."""
    left, rows = sorted(lines, key=lambda one: -one.length_m), []
    while left:
        row, grown = [left.pop(0)], True
        while grown:
            grown = False
            following = [k for k, one in enumerate(left) if any(_follows(other, one) for other in row)]
            for k in reversed(following):
                row.append(left.pop(k))
                grown = True
        if len(row) >= 3:
            rows.append(row)
    return rows


def _follows(one: Marking, other: Marking) -> bool:
    d, e = (line.line[-1, :2] - line.line[0, :2] for line in (one, other))
    d, e = d / np.hypot(*d), e / np.hypot(*e)
    step = other.line[:, :2].mean(axis=0) - one.line[:, :2].mean(axis=0)
    gap = abs(step @ d) - (one.length_m + other.length_m) / 2
    return bool(abs(d @ e) > 0.99 and abs(step @ [-d[1], d[0]]) < 0.25 and -0.2 < gap < 3.0)


def drawn(sheet: GroundSheet, found: Sequence[Marking], kerbs: Sequence[Kerb], scale: int = 2) -> NDArray[np.uint8]:
    """The orthophoto (BGR, north up) with outlines of markings, and kerbs in light blue, cut to what markings and kerbs cover."""
    colour = sheet.colour if sheet.colour.shape[2] == 3 else sheet.colour.repeat(3, axis=2)
    image = cv2.resize(np.ascontiguousarray(colour[..., ::-1]), None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)

    def pixels(points: FloatArray) -> NDArray[np.int32]:
        return np.rint(((points[:, :2] - sheet.corner_m) / PIXEL_M) * scale * 8).astype(np.int32)

    for one in found:
        cv2.polylines(image, [pixels(one.ring)], False, COLOURS[one.kind], 1, cv2.LINE_AA, 3)
    for kerb in kerbs:
        cv2.polylines(image, [pixels(kerb.line)], False, (255, 255, 0), 2, cv2.LINE_AA, 3)
    corners = np.concatenate([pixels(one.ring) // 8 for one in found])
    low, high = np.maximum(corners.min(axis=0) - 60, 0), corners.max(axis=0) + 60
    return np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]][::-1])


if __name__ == "__main__":
    sys.exit(main())
