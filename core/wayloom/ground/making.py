"""Ground sheets of a drive, one submap after the other: views of its keyframes → height surface → orthophoto and votes."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayloom.config.one_heap import give_back
from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import Each, in_order
from wayloom.geometry import se3
from wayloom.ground.exposure import DriveExposure, drive_exposure
from wayloom.ground.picture import OTHER, Picture, picture_of
from wayloom.ground.raster import Raster
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M, LARGEST_SIGMA_MM, NO_HEIGHT, VOTE_UNIT, GroundSheet
from wayloom.ground.sides import give_to_sides
from wayloom.ground.standing import pieces, without_standing
from wayloom.ground.surface import Surface, surface_of
from wayloom.ground.view import GroundView, see_ground
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import one_opencv_thread
from wayloom.odometry.types import OdometryResult
from wayloom.places.road import road_m, spaced
from wayloom.places.stereo_pair import LeftLabels, right_rectifier
from wayloom.submaps.submap import PlacedSubmap, Submap

FloatArray = NDArray[np.float64]
Item = TypeVar("Item")
Result = TypeVar("Result")
SMALLEST_M2: Final = 1.0
"""Ground that is joined to less than this is left out: what far fences and house fronts leave."""
MOST_AT_ONCE: Final = 2
"""Sheets that are made at a time, whatever the threads: each holds the views of its submap."""


def make_sheets(
    log: DriveLog,
    odometry: OdometryResult,
    labels: LeftLabels,
    submaps: Sequence[PlacedSubmap],
    settings: GroundSettings = GroundSettings(),
    progress: Progress = silent,
    threads: int = 1,
) -> Iterator[GroundSheet]:
    """The sheet of each submap that saw ground, in the order of the road; with more threads than one two are made at a time, and
    the views of both by so many threads.

    Raises StageError where an image's labels are missing, LogError where an image cannot be read.
    """
    exposure, chosen = drive_exposure(log, odometry, labels, threads), chosen_keyframes(odometry, settings)

    def sheet(number: int, see: Each, show: Each) -> GroundSheet | None:
        placed = submaps[number]
        views = [view for _, view in views_of(log, odometry, labels, placed, chosen, exposure, settings, see)]
        made = sheet_of(placed.submap, level_frame(placed), views, odometry, exposure, settings, show)
        views.clear()
        give_back()  # what one sheet freed is in pieces that the next one has little use for
        return made

    def alone(number: int) -> GroundSheet | None:
        def told(work: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
            for count, item in enumerate(items):  # progress may stop the work, which is for the caller's thread to hear
                yield work(item)
                progress((number + 0.9 * count / len(items)) / len(submaps), f"ground of submap {number + 1} of {len(submaps)}")

        return sheet(number, told, map)

    with one_opencv_thread(), ThreadPoolExecutor(threads) as pool:
        at_once = min(threads, MOST_AT_ONCE)
        make = alone if threads <= 1 else lambda number: sheet(number, pool.map, pool.map)
        for number, made in enumerate(in_order(make, range(len(submaps)), at_once), 1):
            progress(number / len(submaps), f"ground of {number} of {len(submaps)} submaps")
            if made is not None:
                yield made


def chosen_keyframes(odometry: OdometryResult, settings: GroundSettings) -> NDArray[np.bool_]:
    """(K,) whether sheets are made of a keyframe."""
    return spaced(road_m(odometry.keyframes.T_world_cam), odometry.keyframes.segment, settings.spacing_m)


def views_of(
    log: DriveLog,
    odometry: OdometryResult,
    labels: LeftLabels,
    placed: PlacedSubmap,
    chosen: NDArray[np.bool_],
    exposure: DriveExposure,
    settings: GroundSettings,
    each: Each = map,
) -> list[tuple[int, GroundView]]:
    """Frame and view of the chosen (K,) keyframes of a submap that see ground."""
    rectifier, T_sheet_submap = right_rectifier(odometry), se3.inverse(level_frame(placed))
    rows = np.searchsorted(odometry.keyframes.frame, placed.submap.keyframe_frame)
    seen = [(int(row), T) for row, T in zip(rows, placed.submap.T_submap_cam, strict=True) if chosen[row]]

    def see(keyframe: tuple[int, FloatArray]) -> GroundView | None:
        row, T_submap_cam = keyframe
        balance = (float(exposure.gain[row]), float(exposure.offset[row]), exposure.fall_off)
        frame = int(odometry.keyframes.frame[row])
        return see_ground(log, frame, labels.left(row), rectifier, T_sheet_submap @ T_submap_cam, balance, settings)

    with one_opencv_thread():
        views = zip((int(odometry.keyframes.frame[row]) for row, _ in seen), each(see, seen), strict=True)
        return [(frame, view) for frame, view in views if view is not None]


def level_frame(placed: PlacedSubmap) -> FloatArray:
    """T_submap_sheet (4, 4): the submap's origin, z up and x east as its pose has it."""
    R_enu_submap = placed.T_enu_submap[:3, :3]
    return se3.from_rotation_translation(R_enu_submap.T, np.zeros(3))


def sheet_of(
    submap: Submap,
    T_submap_sheet: FloatArray,
    views: list[GroundView],
    odometry: OdometryResult,
    exposure: DriveExposure,
    settings: GroundSettings,
    each: Each = map,
) -> GroundSheet | None:
    """The sheet that the views make; None where no ground was seen. The list's views are replaced by those without what stands."""
    if not views:
        return None
    raster = raster_around(views, settings.reach_m)
    surface = surface_of(views, raster, odometry.rig, odometry.disparity_bias_px, settings, each)

    def shown(number: int) -> GroundView:
        return without_standing(views[number], raster, surface.height, odometry.rig, odometry.disparity_bias_px, settings)

    for number, view in enumerate(each(shown, range(len(views)))):
        views[number] = view
    picture = picture_of(views, raster, surface.height, odometry.rig, odometry.disparity_bias_px, settings, each)
    give_to_sides(picture.votes, surface.side)
    return cropped(submap, T_submap_sheet, raster, surface, picture, exposure)


def raster_around(views: list[GroundView], reach_m: float) -> Raster:
    """Cells that hold all that the views may see."""
    cameras = np.array([view.T_sheet_cam[:2, 3] for view in views])
    low = np.floor((cameras.min(axis=0) - reach_m) / CELL_M).astype(np.int64)
    high = np.ceil((cameras.max(axis=0) + reach_m) / CELL_M).astype(np.int64)
    return Raster(low, (int(high[1] - low[1]), int(high[0] - low[0])))


def cropped(
    submap: Submap, T_submap_sheet: FloatArray, raster: Raster, surface: Surface, picture: Picture, exposure: DriveExposure
) -> GroundSheet | None:
    """The sheet of the cells that are ground, cut to where there are any; None where there are none."""
    ground = picture.votes[..., :OTHER]
    is_ground = pieces(np.isfinite(surface.height) & (ground.sum(axis=2) > picture.votes[..., OTHER]), SMALLEST_M2 / CELL_M**2)
    if not is_ground.any():
        return None
    rows, columns = (np.flatnonzero(is_ground.any(axis=axis)) for axis in (1, 0))
    part = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    fine = tuple(slice(2 * cut.start, 2 * cut.stop) for cut in part)
    kept = is_ground[part]
    seen = kept.repeat(2, axis=0).repeat(2, axis=1) & (picture.sharpness[fine] > 0.0)
    height_mm = np.rint(1000.0 * np.nan_to_num(surface.height[part])).clip(NO_HEIGHT + 1, -NO_HEIGHT - 1)
    return GroundSheet(
        submap=submap.digest,
        T_submap_sheet=T_submap_sheet,
        corner=(raster.corner + np.array([columns[0], rows[0]])).astype(np.int32),
        t_ns=submap.keyframe_t_ns[[0, -1]].astype(np.int64),
        height_mm=np.where(kept, height_mm, NO_HEIGHT).astype(np.int16),
        sigma_mm=np.where(kept, np.ceil(1000.0 * surface.sigma[part]).clip(1, LARGEST_SIGMA_MM), 0).astype(np.uint8),
        votes=np.where(kept[..., None], np.rint(ground[part] / VOTE_UNIT).clip(0, 65535), 0).astype(np.uint16),
        colour=np.where(seen[..., None], np.rint(exposure.tone(picture.colour[fine])).clip(0, 255), 0).astype(np.uint8),
        sharpness=np.where(seen, np.rint(picture.sharpness[fine]).clip(1, 255), 0).astype(np.uint8),
    )
