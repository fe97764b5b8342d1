"""Place descriptors of a drive, and place views: the surroundings of a keyframe as registration takes them.

A level frame has its origin at the camera, z up by gravity, y along the level heading of the camera's axis, x to its right.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlaceFeatures:
    """Local features with 3D positions, F of them, by keyframe.

    keyframe  (F,) int32 row in Keyframes, not decreasing
    bits      (F, B) uint8 binary descriptor
    uv        (F, 2) float32 px in the keyframe's left image
    p_cam     (F, 3) float32 m in the keyframe's left camera
    sigma_m   (F,) float32 m, along the ray
    """

    keyframe: NDArray[np.int32]
    bits: NDArray[np.uint8]
    uv: NDArray[np.float32]
    p_cam: NDArray[np.float32]
    sigma_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.keyframe)


@dataclass(frozen=True, slots=True)
class PlaceCloud:
    """Static points, P of them, by the keyframe that hosts them.

    keyframe  (P,) int32 row in Keyframes, not decreasing
    p_cam     (P, 3) int16 cm in the host's left camera
    label     (P,) uint8 train id
    sigma_cm  (P,) uint8 cm, along the ray; 255 is that or more
    """

    keyframe: NDArray[np.int32]
    p_cam: NDArray[np.int16]
    label: NDArray[np.uint8]
    sigma_cm: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.keyframe)


@dataclass(frozen=True, slots=True)
class PlaceStations:
    """Keyframes about ten metres of road apart, N of them, by which a place index knows the drive.

    keyframe  (N,) int32 row in Keyframes, increasing
    grid      (N, C, A, L) uint8 bird's-eye descriptor (`wayloom.places.birds_eye`)
    """

    keyframe: NDArray[np.int32]
    grid: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.keyframe)


def no_stations() -> PlaceStations:
    """None."""
    return PlaceStations(np.zeros(0, np.int32), np.zeros((0, 3, 32, 24), np.uint8))


@dataclass(frozen=True, slots=True)
class Places:
    """All that is kept of a drive to recognise and register its places when its images are gone; K keyframes.

    T_world_keyframe  (K, 4, 4) as the odometry left them
    segment           (K,) int32; keyframes of one segment are rigidly connected
    camera            fx, fy, cx, cy, width, height of the left image, px
    features          local features
    cloud             static points
    stations          keyframes by which an index knows the drive
    """

    T_world_keyframe: FloatArray
    segment: NDArray[np.int32]
    camera: tuple[float, float, float, float, int, int]
    features: PlaceFeatures
    cloud: PlaceCloud
    stations: PlaceStations = field(default_factory=no_stations)

    def __len__(self) -> int:
        return len(self.segment)


@dataclass(frozen=True, slots=True)
class PlaceView:
    """Static surroundings of an anchor keyframe: P points, C cameras that saw them, F local features of the keyframes nearby.

    anchor       row of the anchor in Keyframes
    T_level_cam  (4, 4) from the anchor's left camera to its level frame
    xyz          (P, 3) float32 m, level frame; static classes only
    label        (P,) uint8 train id
    sigma_m      (P,) float32 m, along the ray from the camera that hosts the point
    camera       (P,) int32 row of that camera
    cameras      (C, 3) m, level frame
    features     local features; `keyframe` counts rows of `T_level_keyframe` here
    T_level_keyframe  (G, 4, 4) cameras of the features
    """

    anchor: int
    T_level_cam: FloatArray
    xyz: NDArray[np.float32]
    label: NDArray[np.uint8]
    sigma_m: NDArray[np.float32]
    camera: NDArray[np.int32]
    cameras: FloatArray
    features: PlaceFeatures
    T_level_keyframe: FloatArray

    def __len__(self) -> int:
        return len(self.xyz)
