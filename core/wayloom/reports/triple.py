"""Three views of a cloud, as the paper shows them: raw, with classes, and from the street."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.pipeline.drive import DriveResult
from wayloom.pipeline.plane import T_plane_enu
from wayloom.rendering.cameras import oblique, street_level
from wayloom.rendering.colouring import COLOURINGS, way_colours
from wayloom.rendering.labels import laid_over, overlay
from wayloom.rendering.pictures import rendered, with_tracks
from wayloom.rendering.scene import Scene, scene_of_points

SIZE_PX: Final = (1100, 520)
Image = NDArray[np.uint8]


def cloud_views(result: DriveResult) -> dict[str, Image]:
    """(h, w, 3) RGB by caption; none of a drive without points."""
    return scene_views(_scene(result)) if any(len(placed.submap) for placed in result.submaps) else {}


def scene_views(scene: Scene) -> dict[str, Image]:
    """(h, w, 3) RGB by caption; from the street where there is a way."""
    found = {
        "The cloud as the cameras saw it, with the way": _view(scene, "grey", street=False),
        "The same with classes": _view(scene, "class", street=False),
    }
    if scene.tracks:
        found["From the street, halfway"] = _view(scene, "class", street=True)
    return found


def _scene(result: DriveResult) -> Scene:
    T = T_plane_enu(result.geo)
    points = np.concatenate([se3.transform(T, placed.points_enu()) for placed in result.submaps])
    label, grey = (np.concatenate([getattr(placed.submap, name) for placed in result.submaps]) for name in ("label", "grey"))
    return scene_of_points(points, label, grey, se3.transform(T, result.geo.T_enu_cam[:, :3, 3]), result.geo.frame is not None)


def _view(scene: Scene, colouring: str, street: bool) -> Image:
    colours, legend = COLOURINGS[colouring](scene)
    drawn, colours = with_tracks(scene, colours, way_colours(scene, colouring))
    view = street_level(max(scene.tracks, key=len), SIZE_PX) if street else oblique(drawn.points, SIZE_PX, None, scene.tracks)
    return laid_over(rendered(drawn, colours, view), overlay(view, legend, scene.north_up))
