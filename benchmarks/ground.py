"""Ground sheets measured on simulated drives with truth and on a clip with LiDAR; tables as docs/benchmarks/ground.md has them.

    python benchmarks/ground.py drives OUT LOG [OUT LOG ...] [--write drives]
    python benchmarks/ground.py movers OUT LOG [OUT LOG ...] [--write movers]
    python benchmarks/ground.py lidar OUT LOG [--write lidar]
    python benchmarks/ground.py texture OUT LOG [--write texture]
    python benchmarks/ground.py classes OUT LOG [OUT LOG ...] [--write classes]
    python benchmarks/ground.py seams OUT LOG [--write seams]
    python benchmarks/ground.py vignette OUT LOG [OUT LOG ...] [--write vignette]
    python benchmarks/ground.py twin [--write twin]

OUT is what `wayloom process LOG` left of a drive, LOG the drive: as simulated with truth, or in KITTI's raw layout with scans
and the calibration of its day beside it. The sheets are made anew from the images, which is timed; `classes` takes OUT's own.
`lidar` compares the surface with the points of the scans that fall on it, after one offset in height; `texture` correlates the
orthophoto with the city's true ground from above; `classes` are those of sheets beside those of the points of the sparse map;
`seams` are where the view that decides a pixel changes; `vignette` fits what views of one place tell of the light's fall to the
border; `twin` times the kernels of a made street's sheet beside the same without compilation.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from ground_pictures import in_picture, movers_shown, seams, vignette
from pages import DOCS, put_between_marks
from wayloom.config.classes import VOID
from wayloom.evaluation.ground import NEAR_TRACK_M, SheetErrors, compare, scores, true_ground, true_place
from wayloom.evaluation.ground_texture import texture_correlation
from wayloom.geometry import se3
from wayloom.ground.edges import find_steps
from wayloom.ground.exposure import DriveExposure
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.making import chosen_keyframes, make_sheets, raster_around, views_of
from wayloom.ground.picture import picture_of
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES, GroundSheet
from wayloom.ground.sides import laid
from wayloom.ground.standing import without_standing
from wayloom.ground.surface import fuse, gather, smooth
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import open_truth
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import LightSettings
from wayloom.submaps.files import load_submaps

PAGE = DOCS / "benchmarks" / "ground.md"
LIDAR_REACH_M = 25.0
NO_GROUND_M = 0.3
"""Points further from the surface stand on the ground, or are seen past it."""
TWIN_VIEWS, TWIN_REACH_M = 3, 12.0


def make(out: Path, log_path: Path) -> tuple[list[GroundSheet], float]:
    """The sheets of a drive and the CPU milliseconds a frame that they took, without compilation."""
    log = open_log(log_path)
    odometry = load_odometry(out / "stages" / "odometry" / "odometry.npz")
    labels = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame)
    submaps = load_submaps(out / "stages" / "submaps")
    next(make_sheets(log, odometry, labels, submaps[-1:]))
    start = time.process_time()
    sheets = list(make_sheets(log, odometry, labels, submaps))
    return sheets, 1000.0 * (time.process_time() - start) / len(log)


def drives(pairs: list[tuple[Path, Path]]) -> str:
    """Markdown table, a row a drive."""
    lines = [
        "| drive | road, sidewalk, terrain covered (%) | height error (mm): median, p95, bias | errors / sigma |"
        " kerbs at the edge, and from 0.3 m away (mm): median, p90 | IoU (%): road, sidewalk, terrain | true movers shown (ppm) |"
        " CPU ms a frame |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for out, log_path in pairs:
        sheets, cost = make(out, log_path)
        truth = open_truth(log_path)
        ground = true_ground(truth, open_log(log_path).rig.camera)
        submaps = {item.submap.digest: item.submap for item in load_submaps(out / "stages" / "submaps")}
        parts: list[SheetErrors] = []
        for sheet in sheets:
            T_enu_sheet = true_place(submaps[sheet.submap], truth.T_enu_cam) @ sheet.T_submap_sheet
            parts.append(compare(sheet, T_enu_sheet, ground))
        s = scores(parts, ground)
        covered, iou = (", ".join(f"{100 * values.get(k, np.nan):.1f}" for k in (0, 1, 9)) for values in (s.coverage, s.iou))
        height = f"{1e3 * s.median_m:.1f}, {1e3 * s.p95_m:.0f}, {1e3 * s.bias_m:+.1f}"
        kerbs = "; ".join(f"{1e3 * median:.0f}, {1e3 * p90:.0f}" for median, p90 in (s.kerb_m, s.kerb_away_m))
        name = f"{log_path.parent.name}/{log_path.name}"
        lines.append(
            f"| {name} | {covered} | {height} | {s.normalised_error:.2f} | {kerbs} | {iou} |"
            f" {1e6 * movers_shown(out, log_path):.0f} | {cost:.0f} |"
        )
    return "\n".join(lines) + "\n"


def lidar(out: Path, log_path: Path) -> str:
    """Markdown table: the surface against the scans, by reach."""
    sheets, cost = make(out, log_path)
    log, odometry = open_log(log_path), load_odometry(out / "stages" / "odometry" / "odometry.npz")
    submaps = {item.submap.digest: item.submap for item in load_submaps(out / "stages" / "submaps")}
    T_cam_velo = velodyne_pose(log_path)
    apart, far, stands = [], [], []
    for sheet in sheets:
        submap = submaps[sheet.submap]
        anchor = submap.keyframe_frame[np.argmin(np.linalg.norm(submap.T_submap_cam[:, :3, 3], axis=1))]
        T_sheet_world = se3.inverse(sheet.T_submap_sheet) @ se3.inverse(odometry.trajectory.T_world_cam[anchor])
        for scan in sorted((log_path / "velodyne_points" / "data").glob("*.bin")):
            frame = int(scan.stem)
            if not submap.keyframe_frame[0] <= frame <= submap.keyframe_frame[-1] or frame >= len(log):
                continue
            points = np.fromfile(scan, "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
            reach = np.linalg.norm(points[:, :2], axis=1)
            T_sheet_velo = T_sheet_world @ odometry.trajectory.T_world_cam[frame] @ T_cam_velo
            on = se3.transform(T_sheet_velo, points[reach < LIDAR_REACH_M])
            at = np.floor(on[:, :2] / CELL_M).astype(np.int64) - sheet.corner
            rows, columns = sheet.height_mm.shape
            inside = (at >= 0).all(axis=1) & (at[:, 0] < columns) & (at[:, 1] < rows)
            apart.append(sheet.height[at[inside, 1], at[inside, 0]] - on[inside, 2])
            far.append(reach[reach < LIDAR_REACH_M][inside])
            highest = np.full((rows, columns), -np.inf)
            np.maximum.at(highest, (at[inside, 1], at[inside, 0]), on[inside, 2])
            above = cv2.dilate(highest, np.ones((3, 3), np.uint8))[at[inside, 1], at[inside, 0]]
            stands.append(above > on[inside, 2] + NO_GROUND_M)
    error, distance, standing = np.concatenate(apart), np.concatenate(far), np.concatenate(stands)
    known = np.abs(error - np.nanmedian(error)) < NO_GROUND_M
    offset = float(np.median(error[known]))
    lines = ["| from the scanner (m) | points | median (mm) | p95 (mm) |", "| --- | --- | --- | --- |"]
    reaches = ((0.0, 10.0), (10.0, 15.0), (15.0, LIDAR_REACH_M), (0.0, LIDAR_REACH_M))
    parts = [(f"{low:.0f} to {high:.0f}", (distance >= low) & (distance < high)) for low, high in reaches]
    parts += [("the same, nothing stands there in the scan", ~standing), ("something does", standing)]
    for name, part in parts:
        here = np.abs(error[known & part] - offset)
        lines.append(f"| {name} | {len(here)} | {1e3 * np.median(here):.1f} | {1e3 * np.percentile(here, 95):.0f} |")
    return "\n".join(lines) + f"\n\nOffset {1e3 * offset:+.0f} mm; {cost:.0f} CPU ms a frame.\n"


def texture(out: Path, log_path: Path) -> str:
    """Markdown table: correlation of the orthophoto with the true texture, by the sharpness that it was seen with."""
    sheets, _ = make(out, log_path)
    preset = json.loads((log_path.parent / "simulation.json").read_text())["preset"]
    light = LightSettings(**{**preset["light"], "haze_per_m": 0.0})
    world = build_world(CitySettings(**preset["city"]), light, "half")
    truth = open_truth(log_path)
    submaps = {item.submap.digest: item.submap for item in load_submaps(out / "stages" / "submaps")}
    parts = []
    for sheet in sheets:
        T_enu_sheet = true_place(submaps[sheet.submap], truth.T_enu_cam) @ sheet.T_submap_sheet
        parts.append(np.column_stack(texture_correlation(sheet, T_enu_sheet, world)))
    correlation, sharpness = np.concatenate(parts).T
    lines = ["| image pixels a metre | cells of 1 m | correlation: p10, median, p90 |", "| --- | --- | --- |"]
    for low, high in ((0, 2), (2, 4), (4, 255)):
        here = correlation[(sharpness >= low) & (sharpness < high)]
        values = ", ".join(f"{value:.2f}" for value in np.percentile(here, (10, 50, 90))) if len(here) else ""
        lines.append(f"| {low} to {high} | {len(here)} | {values} |")
    return "\n".join(lines) + "\n"


def classes(pairs: list[tuple[Path, Path]]) -> str:
    """Markdown table: classes of the ground by sheets and by the sparse map's points, on cells of true ground near the track."""
    lines = [
        "| drive | | true ground that it tells of (%) | IoU (%): road, sidewalk, terrain | mean |",
        "| --- | --- | --- | --- | --- |",
    ]
    for out, log_path in pairs:
        truth = open_truth(log_path)
        ground, submaps = true_ground(truth, open_log(log_path).rig.camera), load_submaps(out / "stages" / "submaps")
        near = (ground.distance <= NEAR_TRACK_M) & (ground.class_id != VOID)
        by_sheets, by_points = (np.full(ground.class_id.shape, VOID, np.uint8) for _ in range(2))
        places = {item.submap.digest: true_place(item.submap, truth.T_enu_cam) for item in submaps}
        for item in submaps:
            row, column, inside = ground.place(se3.transform(places[item.submap.digest], item.submap.xyz.astype(np.float64)))
            by_points[row[inside], column[inside]] = item.submap.label[inside]
        for sheet in (load_sheet(out / "stages" / "ground", digest) for digest in read_index(out / "stages" / "ground").values()):
            r, c = np.nonzero(np.isfinite(sheet.height))
            xy = sheet.corner_m + (np.column_stack([c, r]) + 0.5) * CELL_M
            points = se3.transform(places[sheet.submap] @ sheet.T_submap_sheet, np.column_stack([xy, sheet.height[r, c]]))
            row, column, inside = ground.place(points)
            by_sheets[row[inside], column[inside]] = sheet.label[r, c][inside]
        both = near & np.isin(by_points, GROUND_CLASSES) & (by_sheets != VOID)
        for name, said, among in (
            ("sheets", by_sheets, near & (by_sheets != VOID)),
            ("points", by_points, near & np.isin(by_points, GROUND_CLASSES)),
            ("sheets where there are points", by_sheets, both),
            ("points where there are sheets", by_points, both),
        ):
            true = ground.class_id
            iou = [
                ((said == k) & (true == k) & among).sum() / max((((said == k) | (true == k)) & among).sum(), 1)
                for k in GROUND_CLASSES
            ]
            lines.append(
                f"| {log_path.parent.name}/{log_path.name} | {name} | {100 * among.sum() / near.sum():.1f} |"
                f" {', '.join(f'{100 * one:.1f}' for one in iou)} | {100 * np.mean(iou):.1f} |"
            )
    return "\n".join(lines) + "\n"


def twin() -> str:
    """Markdown table: CPU seconds of the steps of a made street's sheet, compiled and not."""
    compiled, naive = (
        json.loads(
            subprocess.run(
                [sys.executable, __file__, "steps"], env={**os.environ, "NUMBA_DISABLE_JIT": off}, check=True, capture_output=True
            ).stdout
        )
        for off in ("0", "1")
    )
    lines = ["| step | compiled (CPU ms) | not compiled (CPU ms) | times |", "| --- | --- | --- | --- |"]
    for name, seconds in compiled.items():
        lines.append(f"| {name} | {1e3 * seconds:.1f} | {1e3 * naive[name]:.0f} | {naive[name] / seconds:.0f} |")
    return "\n".join(lines) + "\n"


def step_seconds() -> dict[str, float]:
    """CPU seconds of the steps, with the kernels as this process has them, of TWIN_VIEWS views of the made street."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    from made_ground import MadeStreet

    street, settings = MadeStreet(count=TWIN_VIEWS), GroundSettings(reach_m=TWIN_REACH_M)
    odometry = street.odometry()
    exposure = DriveExposure(np.ones(TWIN_VIEWS), np.zeros(TWIN_VIEWS), 255.0, 0.0)
    chosen, about = chosen_keyframes(odometry, settings), (street.rig, 0.0)
    seen = views_of(street, odometry, street, street.submaps()[0], chosen, exposure, settings)
    views = [view for _, view in seen]
    raster, seconds = raster_around(views, settings.reach_m), {}
    for _ in range(1 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 2):  # the first compiles
        marks = [time.process_time()]
        cells = fuse(gather(views, raster, *about, settings.reach_m), raster.shape)
        marks.append(time.process_time())
        cells, side = laid(find_steps(views, raster, cells, *about), cells, raster)
        marks.append(time.process_time())
        height = smooth(cells, side, round(settings.smoothing_m / CELL_M)).height
        marks.append(time.process_time())
        views = [without_standing(view, raster, height, *about, settings) for view in views]
        marks.append(time.process_time())
        picture_of(views, raster, height, *about, settings)
        marks.append(time.process_time())
        names = ("samples and cells", "kerbs", "surface", "what stands", "orthophoto and votes")
        seconds = dict(zip(names, np.diff(marks).tolist(), strict=True))
    return seconds


def velodyne_pose(log_path: Path) -> np.ndarray:
    """T_cam_velo (4, 4) of KITTI's left colour camera, from the calibration files of the day."""
    day = log_path.parent
    told = _numbers(day / "calib_velo_to_cam.txt")
    cameras = _numbers(day / "calib_cam_to_cam.txt")
    T_grey_velo = se3.from_rotation_translation(told["R"].reshape(3, 3), told["T"])
    R_rect = se3.from_rotation_translation(cameras["R_rect_00"].reshape(3, 3), np.zeros(3))
    P = cameras["P_rect_02"].reshape(3, 4)
    return se3.from_rotation_translation(np.eye(3), np.linalg.solve(P[:, :3], P[:, 3])) @ R_rect @ T_grey_velo


def _numbers(file: Path) -> dict[str, np.ndarray]:
    rows = (line.split(":", 1) for line in file.read_text().splitlines() if ":" in line)
    return {name: np.array(text.split(), float) for name, text in rows if name not in ("calib_time", "corner_dist")}


def main() -> None:
    """Measure, print, and write where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("drives", "movers", "lidar", "texture", "classes", "seams", "vignette", "twin", "steps"))
    parser.add_argument("paths", nargs="*", type=Path, help="OUT LOG, in pairs")
    parser.add_argument("--write", metavar="NAME")
    asked = parser.parse_args()
    pairs = list(zip(asked.paths[::2], asked.paths[1::2], strict=True))
    if asked.what == "steps":
        sys.exit(print(json.dumps(step_seconds())))
    of_all = {"drives": drives, "movers": in_picture, "classes": classes, "vignette": vignette}
    of_one = {"lidar": lidar, "texture": texture, "seams": seams}
    if asked.what in of_all:
        text = of_all[asked.what](pairs)
    else:
        text = twin() if asked.what == "twin" else of_one[asked.what](*pairs[0])
    print(text)
    if asked.write:
        put_between_marks(PAGE, asked.write, text)


if __name__ == "__main__":
    main()
