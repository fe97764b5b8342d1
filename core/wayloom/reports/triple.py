"""Three views of a cloud, as the paper shows them: raw, with classes, and from the street."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.pipeline.drive_result import DriveResult
from wayloom.pipeline.plane import T_plane_enu
from wayloom.rendering.cameras import oblique, street_level
from wayloom.rendering.colouring import COLOURINGS, way_colours
from wayloom.rendering.labels import laid_over, overlay
from wayloom.rendering.pictures import rendered, with_tracks
from wayloom.rendering.scene import Scene, scene_of_points

SIZE_PX: Final = (1100, 520)
MOST_DRAWN: Final = 1_000_000
"""Points of a picture, which is drawn with 2.3 million pixels: some kilometres of road have as many."""
SIGHT_M: Final = 500.0
"""From the street; what is beyond lies in the haze."""
FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]


def cloud_views(result: DriveResult) -> dict[str, Image]:
    """(h, w, 3) RGB by caption; none of a drive without points."""
    sizes = [len(placed.submap) for placed in result.submaps]
    if not any(sizes):
        return {}
    track = se3.transform(T_plane_enu(result.geo), result.geo.T_enu_cam[:, :3, 3])
    shown = whole_views(_scene(result, range(len(sizes)), sizes, track))
    near = _rows_near(result, halfway(track))
    return shown | street_view(_scene(result, near, sizes, track)) if any(sizes[row] for row in near) else shown


def scene_views(scene: Scene) -> dict[str, Image]:
    """(h, w, 3) RGB by caption; from the street where there is a way."""
    return whole_views(scene) | street_view(scene)


def whole_views(scene: Scene) -> dict[str, Image]:
    """(h, w, 3) RGB by caption, from beside the whole of it."""
    return {
        "The cloud as the cameras saw it, with the way": _view(scene, "grey", street=False),
        "The same with classes": _view(scene, "class", street=False),
    }


def street_view(scene: Scene) -> dict[str, Image]:
    """(h, w, 3) RGB by caption, where there is a way."""
    return {"From the street, halfway": _view(scene, "class", street=True)} if scene.tracks else {}


def halfway(track: FloatArray) -> FloatArray:
    """(3,) the place in the middle of the road (K, 3) m, however long the drive stood where, as `street_level` looks from it."""
    road = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track, axis=0), axis=1))])
    return np.array([np.interp(0.5 * road[-1], road, axis) for axis in track.T])


def _rows_near(result: DriveResult, place: FloatArray) -> list[int]:
    """Submaps whose anchor lies within sight of a place (3,) m of the plane."""
    T = T_plane_enu(result.geo)
    return [
        row
        for row, placed in enumerate(result.submaps)
        if np.linalg.norm(se3.transform(T, placed.T_enu_submap[None, :3, 3])[0] - place) < SIGHT_M
    ]


def _scene(result: DriveResult, rows: Sequence[int], sizes: Sequence[int], track: FloatArray) -> Scene:
    """The points of these submaps, of very many only each so-manieth, with the whole way (K, 3) m."""
    T, step = T_plane_enu(result.geo), max(1, -(-sum(sizes[row] for row in rows) // MOST_DRAWN))
    points, labels, greys = [np.zeros((0, 3))], [np.zeros(0, np.uint8)], [np.zeros(0, np.uint8)]
    for row in rows:
        placed = result.submaps[row]
        points.append(se3.transform(T, placed.points_enu()[::step]))
        labels.append(placed.submap.label[::step])
        greys.append(placed.submap.grey[::step])
    columns = np.concatenate(points), np.concatenate(labels), np.concatenate(greys)
    return scene_of_points(*columns, track, result.geo.frame is not None)


def _view(scene: Scene, colouring: str, street: bool) -> Image:
    colours, legend = COLOURINGS[colouring](scene)
    drawn, colours = with_tracks(scene, colours, way_colours(scene, colouring))
    view = street_level(max(scene.tracks, key=len), SIZE_PX) if street else oblique(drawn.points, SIZE_PX, None, scene.tracks)
    return laid_over(rendered(drawn, colours, view), overlay(view, legend, scene.north_up))
