"""Submap: the labelled points of 50 to 100 m of one drive, in its own frame, immutable and addressed by its content.

Its frame is the left camera of its anchor, the keyframe in its middle. Its points come from the odometry alone, so nothing that is
optimised later changes them: where a submap lies (`PlacedSubmap`) is kept beside it.

Its bytes are a `wayloom.files.blob` (`docs/formats.md`, "Submaps").
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.geodesy.map_frame import MapFrame

FloatArray = NDArray[np.float64]
MAGIC: Final = b"WLSUBMAP"
VERSION: Final = 1
DTYPES: Final = {
    "xyz": "<f4", "label": "|u1", "variance": "<f4", "grey": "|u1", "seen_ns": "<i8", "keyframe": "<u4",
    "vote_start": "<u4", "vote_class": "|u1", "vote_weight": "<f4",
    "keyframe_frame": "<u4", "keyframe_t_ns": "<i8", "T_submap_cam": "<f8",
}  # fmt: skip


@dataclass(frozen=True)
class Submap:
    """P points, V votes, K keyframes.

    xyz             (P, 3) float32 m, submap frame
    label           (P,) uint8 train id, 255 void
    variance        (P,) float32 m^2: of the position, along its worst axis (mostly the ray)
    grey            (P,) uint8
    seen_ns         (P,) int64 time of the host's image
    keyframe        (P,) uint32 host, row of the tables below
    vote_start      (P + 1,) uint32; vote_class (V,) uint8; vote_weight (V,) float32: the votes as in `PointLabels`
    keyframe_frame  (K,) uint32 frame of the drive; keyframe_t_ns (K,) int64; T_submap_cam (K, 4, 4) float64
    length_m        metres of road
    points_left_out how many points of the stretch were dropped, by reason
    """

    xyz: NDArray[np.float32]
    label: NDArray[np.uint8]
    variance: NDArray[np.float32]
    grey: NDArray[np.uint8]
    seen_ns: NDArray[np.int64]
    keyframe: NDArray[np.uint32]
    vote_start: NDArray[np.uint32]
    vote_class: NDArray[np.uint8]
    vote_weight: NDArray[np.float32]
    keyframe_frame: NDArray[np.uint32]
    keyframe_t_ns: NDArray[np.int64]
    T_submap_cam: FloatArray
    length_m: float
    points_left_out: dict[str, int]

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def encoded(self) -> bytes:
        """The submap's bytes, made anew each time: as large as the submap."""
        header = {"length_m": self.length_m, "points_left_out": self.points_left_out}
        return encode_blob(MAGIC, VERSION, header, {name: np.asarray(getattr(self, name), dtype) for name, dtype in DTYPES.items()})

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the bytes, hexadecimal: the submap's name."""
        return hashlib.sha256(self.encoded).hexdigest()


def decode_submap(data: bytes, name: str = "submap", digest: str | None = None) -> Submap:
    """The submap of these bytes. Raises InputError when they are none, cut off or of another version.

    digest : of the bytes, where it is known; the submap then never encodes itself for its name
    """
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        submap = Submap(**arrays, length_m=header["length_m"], points_left_out=header["points_left_out"])
        if digest is not None:
            vars(submap)["digest"] = digest  # where the cached property looks for it
        return submap
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no submap or is damaged ({error})", file=name, remedy="make the submaps again") from error


@dataclass(frozen=True, slots=True)
class StepBefore:
    """What joins a submap to the one before it on the road, by the drive's own graph.

    cross      (6, 6) covariance of the left perturbations of the submap before (rows) and of this one (columns), m^2 and rad^2
    connected  whether the odometry tracked all the way from there
    """

    cross: FloatArray
    connected: bool

    def content(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"cross": self.cross.tolist(), "connected": self.connected}

    @classmethod
    def of(cls, content: dict[str, Any]) -> "StepBefore":
        """The inverse of `content`."""
        return cls(np.array(content["cross"], np.float64), bool(content["connected"]))


@dataclass(frozen=True, slots=True)
class PlacedSubmap:
    """A submap with its pose in the map.

    T_enu_submap  (4, 4) in the map's frame; in the drive's own where frame is None
    covariance    (6, 6) of its left perturbation (v, omega), m^2, rad^2; NaN without frame
    before        what joins it to the submap before; None for the first, and where it is not told
    bend          (K, 6) one-sigma left perturbations of T_submap_cam, m and rad: by so much the drive's graph has each keyframe
                  elsewhere than the rigid submap, where that is more than its own noise (`wayloom.submaps.bend`); None where it is
                  not told
    """

    submap: Submap
    T_enu_submap: FloatArray
    covariance: FloatArray
    drive_id: str
    frame: MapFrame | None
    before: StepBefore | None = None
    bend: FloatArray | None = None

    def points_enu(self) -> FloatArray:
        """(P, 3) m."""
        points: FloatArray = self.submap.xyz.astype(np.float64) @ self.T_enu_submap[:3, :3].T + self.T_enu_submap[:3, 3]
        return points

    def track_enu(self) -> FloatArray:
        """(K, 3) m: the keyframes' cameras in time order."""
        points: FloatArray = self.submap.T_submap_cam[:, :3, 3] @ self.T_enu_submap[:3, :3].T + self.T_enu_submap[:3, 3]
        return points
