"""Orthophotos of drives judged: persons and vehicles in them, seams, and the light's fall to the border (for `ground.py`)."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from wayloom.config.classes import MOVING_CLASSES, PERSONS
from wayloom.evaluation.ground import NEAR_TRACK_M, true_ground, true_place
from wayloom.geometry import se3
from wayloom.ground.exposure import drive_exposure
from wayloom.ground.making import chosen_keyframes, level_frame, raster_around, views_of
from wayloom.ground.picture import picture_of
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES, PIXEL_M
from wayloom.ground.standing import without_standing
from wayloom.ground.surface import surface_of
from wayloom.ground.view import GroundView, may_be_shown
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import open_truth
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.submaps.files import load_submaps

SEAM_PX = 5
VIGNETTE_VIEWS = 16


def movers_shown(out: Path, log_path: Path) -> float:
    """Share of the pixels that may be shown, of all keyframes, that are persons or vehicles in truth."""
    odometry, truth = load_odometry(out / "stages" / "odometry" / "odometry.npz"), open_truth(log_path)
    labels = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame)
    wrong, total = 0, 0
    for row, frame in enumerate(odometry.keyframes.frame.tolist()):
        shown = may_be_shown(labels.left(row), GroundSettings().mover_margin_share) > 0.0
        wrong += int(np.isin(truth.class_id(frame)[shown], MOVING_CLASSES).sum())
        total += int(shown.sum())
    return wrong / max(total, 1)


def in_picture(pairs: list[tuple[Path, Path]]) -> str:
    """Markdown table: true persons and vehicles in the orthophotos, with what stands on the ground in the views and without."""
    lines = [
        "| drive | | pixels (millions) | road, sidewalk, terrain shown (%) | persons: over a quarter, any (ppm) |"
        " vehicles: over a quarter, any (ppm) |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for out, log_path in pairs:
        rows = drive_in_picture(out, log_path)
        lines += [f"| {log_path.parent.name}/{log_path.name} | {which} | {row} |" for which, row in rows.items()]
    return "\n".join(lines) + "\n"


def drive_in_picture(out: Path, log_path: Path) -> dict[str, str]:
    """Rows of one drive. The images are replaced by the true classes after the views have been matched and judged."""
    log, truth, odometry = open_log(log_path), open_truth(log_path), load_odometry(out / "stages" / "odometry" / "odometry.npz")
    labels, settings = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame), GroundSettings()
    exposure, chosen = drive_exposure(log, odometry, labels), chosen_keyframes(odometry, settings)
    ground, bias_px = true_ground(truth, log.rig.camera), odometry.disparity_bias_px
    counts = {which: np.zeros(5) for which in ("as labelled", "less what stands")}
    covered = {which: np.zeros(ground.height.shape, bool) for which in counts}
    for placed in load_submaps(out / "stages" / "submaps"):
        seen = views_of(log, odometry, labels, placed, chosen, exposure, settings)
        if not seen:
            continue
        raster = raster_around([view for _, view in seen], settings.reach_m)
        height = surface_of([view for _, view in seen], raster, odometry.rig, bias_px, settings).height
        for which in counts:
            views = []
            for frame, view in seen:
                kept = view if which == "as labelled" else without_standing(view, raster, height, odometry.rig, bias_px, settings)
                views.append(
                    replace(kept, image=movers_image(truth.class_id(frame)[view.first_row :]), gain=1.0, offset=0.0, fall_off=0.0)
                )
            picture = picture_of(views, raster, height, odometry.rig, bias_px, settings)
            there = picture.sharpness > 0.0
            share = picture.colour[there] / 255.0
            counts[which] += [there.sum(), *(share > 0.25).sum(axis=0), *(share > 0.004).sum(axis=0)]
            T_enu_sheet = true_place(placed.submap, truth.T_enu_cam) @ level_frame(placed)
            r, c = np.nonzero(there.reshape(*raster.shape[:1], 2, raster.shape[1], 2).any(axis=(1, 3)) & np.isfinite(height))
            xy = raster.low + (np.column_stack([c, r]) + 0.5) * CELL_M
            row, column, inside = ground.place(se3.transform(T_enu_sheet, np.column_stack([xy, height[r, c]])))
            covered[which][row[inside], column[inside]] = True
    near, rows = ground.distance <= NEAR_TRACK_M, {}
    for which, (pixels, person, vehicle, any_person, any_vehicle) in counts.items():
        shown = ", ".join(f"{100 * covered[which][near & (ground.class_id == k)].mean():.1f}" for k in GROUND_CLASSES)
        ppm = [f"{1e6 * n / pixels:.0f}" for n in (person, any_person, vehicle, any_vehicle)]
        rows[which] = f"{1e-6 * pixels:.2f} | {shown} | {ppm[0]}, {ppm[1]} | {ppm[2]}, {ppm[3]}"
    return rows


def movers_image(class_id: np.ndarray) -> np.ndarray:
    """(h, w, 2) uint8: 255 where a true person, and a vehicle, is."""
    person = np.isin(class_id, PERSONS)
    return np.stack([255 * person, 255 * (np.isin(class_id, MOVING_CLASSES) & ~person)], axis=-1).astype(np.uint8)


def seams(out: Path, log_path: Path) -> str:
    """Markdown table: steps of the orthophoto's grey from pixel to pixel, and between means over SEAM_PX pixels on both sides,
    where the view that weighs most changes and where it does not."""
    log, odometry = open_log(log_path), load_odometry(out / "stages" / "odometry" / "odometry.npz")
    labels, settings = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame), GroundSettings()
    exposure, chosen = drive_exposure(log, odometry, labels), chosen_keyframes(odometry, settings)
    found: dict[tuple[int, bool], list[np.ndarray]] = {}
    for placed in load_submaps(out / "stages" / "submaps"):
        views = [view for _, view in views_of(log, odometry, labels, placed, chosen, exposure, settings)]
        raster = raster_around(views, settings.reach_m)
        about = (odometry.rig, odometry.disparity_bias_px, settings)
        height = surface_of(views, raster, *about).height
        views = [without_standing(view, raster, height, *about) for view in views]
        picture = picture_of(views, raster, height, *about)
        grey = exposure.tone(picture.colour).mean(axis=2)
        best, most = np.full(grey.shape, -1), np.zeros(grey.shape, np.float32)
        for number, view in enumerate(views):
            sharp = picture_of([view], raster, height, *about).sharpness
            best, most = np.where(sharp > most, number, best), np.maximum(sharp, most)
        for size in (1, SEAM_PX):
            mean = cv2.blur(grey, (size, size))
            whole = cv2.erode((picture.sharpness > 0.0).astype(np.uint8), np.ones((2 * size + 1, 2 * size + 1), np.uint8)) > 0
            step, gap = np.abs(mean[:, size:] - mean[:, :-size]), (size - 1) // 2
            width = step.shape[1]
            at = best[:, gap : gap + width] != best[:, gap + 1 : gap + 1 + width]
            known = whole[:, size:] & whole[:, :-size]
            for is_seam in (False, True):
                found.setdefault((size, is_seam), []).append(step[known & (at == is_seam)])
    lines = ["| | places | grey levels of 255: median, p90, p99 |", "| --- | --- | --- |"]
    for (size, is_seam), parts in found.items():
        steps = np.concatenate(parts)
        values = ", ".join(f"{value:.1f}" for value in np.percentile(steps, (50, 90, 99)))
        what = "from pixel to pixel" if size == 1 else f"between means of {100 * SEAM_PX * PIXEL_M:.0f} cm"
        lines.append(f"| {what}, {'at seams' if is_seam else 'elsewhere'} | {len(steps)} | {values} |")
    return "\n".join(lines) + "\n"


def vignette(pairs: list[tuple[Path, Path]]) -> str:
    """Markdown table: the fall-off p of (1 + r^2)^-p, r = tan of the angle from the axis, that is taken out of a drive, and what
    the views of each stretch of VIGNETTE_VIEWS tell of it on the sheets' own surface, with a power of the depth beside it, for
    near and far views of ground differ by themselves: as the images are, and as sheets show them."""
    lines = [
        "| drive | taken out | | stretches | fall-off: median, lowest, highest | brightness at r = 0.86 |"
        " views of a place differ by (%) |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for out, log_path in pairs:
        log, odometry = open_log(log_path), load_odometry(out / "stages" / "odometry" / "odometry.npz")
        labels, settings = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame), GroundSettings()
        exposure, chosen = drive_exposure(log, odometry, labels), chosen_keyframes(odometry, settings)
        fits: dict[str, list[tuple[float, float]]] = {"as it is": [], "undone": []}
        for placed in load_submaps(out / "stages" / "submaps"):
            views = [view for _, view in views_of(log, odometry, labels, placed, chosen, exposure, settings)]
            for first in range(0, len(views) - VIGNETTE_VIEWS + 1, VIGNETTE_VIEWS):
                stretch = views[first : first + VIGNETTE_VIEWS]
                fits["as it is"].append(light_fall([replace(view, fall_off=0.0) for view in stretch], odometry, settings))
                fits["undone"].append(light_fall(stretch, odometry, settings))
        for which, found in fits.items():
            fall_off, apart = np.array(found).T
            middle, name = float(np.median(fall_off)), f"{log_path.parent.name}/{log_path.name}"
            lines.append(
                f"| {name} | {exposure.fall_off:.2f} | {which} | {len(fall_off)} |"
                f" {middle:.2f}, {fall_off.min():.2f}, {fall_off.max():.2f} |"
                f" {(1 + 0.86**2) ** -middle:.2f} | {100 * np.median(apart):.1f} |"
            )
    return "\n".join(lines) + "\n"


def light_fall(views: list[GroundView], odometry: OdometryResult, settings: GroundSettings) -> tuple[float, float]:
    """The fall-off that the views of one stretch tell, and by how much (median, log) those of a place differ from their mean."""
    raster, about = raster_around(views, settings.reach_m), (odometry.rig, odometry.disparity_bias_px, settings)
    height = surface_of(views, raster, *about).height
    place, fall, depth, level = [], [], [], []
    for view in views:
        picture = picture_of([view], raster, height, *about)
        r, c = np.nonzero(picture.sharpness[::6, ::6] > 0.0)
        xy = raster.low + (np.column_stack([6 * c, 6 * r]) + 0.5) * PIXEL_M
        cam = se3.transform(se3.inverse(view.T_sheet_cam), np.column_stack([xy, height[3 * r, 3 * c]]))
        place.append(r * raster.shape[1] + c)
        fall.append(-np.log1p((cam[:, 0] ** 2 + cam[:, 1] ** 2) / cam[:, 2] ** 2))
        depth.append(np.log(cam[:, 2]))
        level.append(np.log(np.maximum(picture.colour[6 * r, 6 * c].mean(axis=1), 1.0)))
    _, inverse, count = np.unique(np.concatenate(place), return_inverse=True, return_counts=True)
    several = count[inverse] > 1
    A, y = (
        np.column_stack([one - np.bincount(inverse, one)[inverse] / count[inverse] for one in map(np.concatenate, parts)])[several]
        for parts in ((fall, depth), (level,))
    )
    x, weight = np.zeros(2), np.ones(len(y))
    for _ in range(10):
        W = A * weight[:, None]
        x = np.linalg.solve(W.T @ A, W.T @ y[:, 0])
        weight = 1.0 / (1.0 + ((y[:, 0] - A @ x) / 0.05) ** 2)
    return float(x[0]), float(np.median(np.abs(y)))
