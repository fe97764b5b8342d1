"""Pictures of a scene: drawn at twice the size, lit, laid on a background, labelled."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.rendering.cameras import Viewpoint
from wayloom.rendering.colouring import Colours
from wayloom.rendering.scene import Scene
from wayloom.rendering.shading import SUPERSAMPLING, Buffer, drawn, lit

Picture = NDArray[np.uint8]
SKY: Final = np.array([[233, 237, 242], [251, 250, 247]], np.float32)
"""RGB of the background, top and bottom."""
TRACK_SIZE_M: Final = 0.3
TRACK_STEP_M: Final = 0.12


def rendered(scene: Scene, colours: Colours, view: Viewpoint) -> Picture:
    """(H, W, 3) RGB of the scene's points in these colours (N, 3)."""
    large = view.enlarged(SUPERSAMPLING)
    buffer = drawn(scene.points, scene.size_m, large)
    seen = buffer.shown >= 0
    picture = _background(large)
    picture[seen] = colours[buffer.shown[seen]]
    picture[seen] *= lit(buffer, SUPERSAMPLING)[seen, None]
    if view.focal_px is not None:
        _fade(picture, buffer, seen)
    width, height = view.size_px
    return np.asarray(np.clip(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), 0, 255), np.uint8)


def with_tracks(scene: Scene, colours: Colours, ways: Colours) -> tuple[Scene, Colours]:
    """The same scene with the drives' ways drawn as beads along them, in the colours (K, 3) of the K ways."""
    if not scene.tracks:
        return scene, colours
    drawn = [_beads(way) for way in scene.tracks]
    beads = np.concatenate(drawn).astype(np.float32)
    count, of_bead = len(beads), np.repeat(ways, [len(one) for one in drawn], axis=0)
    more = Scene(
        np.concatenate([scene.points, beads]), np.concatenate([scene.label, np.full(count, 255, np.uint8)]),
        np.concatenate([scene.photo, np.zeros((count, 3), np.uint8)]),
        np.concatenate([scene.size_m, np.full(count, TRACK_SIZE_M, np.float32)]),
        np.concatenate([scene.drive, np.full(count, -1, np.int16)]), scene.tracks, scene.drives, scene.north_up,
    )  # fmt: skip
    return more, np.concatenate([colours, of_bead])


def _beads(way: NDArray[np.float64]) -> NDArray[np.float64]:
    road = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))]
    at = np.arange(0.0, road[-1], TRACK_STEP_M)
    return np.column_stack([np.interp(at, road, way[:, axis]) for axis in range(3)])


def _background(view: Viewpoint) -> NDArray[np.float32]:
    width, height = view.size_px
    share = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None]
    row = SKY[:1] * (1.0 - share) + SKY[1:] * share
    return np.ascontiguousarray(np.broadcast_to(row[:, None], (height, width, 3)))


def _fade(picture: NDArray[np.float32], buffer: Buffer, seen: NDArray[np.bool_]) -> None:
    """What is far takes a little of the background."""
    depth = buffer.nearest[seen]
    if not len(depth):
        return
    near, far = np.quantile(depth[:: max(1, len(depth) // 50_000)], [0.05, 0.999])
    haze = 0.55 * np.clip((depth - near) / max(float(far - near), 1.0), 0.0, 1.0)[:, None] ** 1.5
    picture[seen] = picture[seen] * (1.0 - haze) + SKY.mean(axis=0) * haze
