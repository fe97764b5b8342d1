"""Drives and their meetings as the city graph takes them, and where it places their submaps."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Meeting:
    """One registration of a submap of drive b to a submap of drive a.

    submap_a, submap_b  index in the drive's submaps, in the order of the road
    T_a_b       (4, 4) from the frame of submap b to that of submap a, m
    covariance  (6, 6) of its left perturbation (v, omega), in the frame of submap a: T_a_b <- exp(xi) T_a_b; m^2 and rad^2
    """

    drive_a: str
    submap_a: int
    drive_b: str
    submap_b: int
    T_a_b: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class DrivePlaces:
    """The n submaps of a drive as its own graph placed them.

    T_map_submap  (n, 4, 4) in the map's frame, m; in the drive's own level frame where it is not located
    covariance    (n, 6, 6) of the left perturbation (v, omega), m^2 and rad^2
    length_m      (n,) m of road of each submap
    connected     (n - 1,) false where the track was lost between a submap and the next
    cross         (n - 1, 6, 6) covariance of the left perturbations of a submap (rows) and the next (columns), as the drive's
                  graph tells it; where that is NaN, and without it, it is derived (`wayloom.stitching.drive_chain`)
    located       whether the frame is the map's: the drive has GNSS
    """

    drive_id: str
    T_map_submap: FloatArray
    covariance: FloatArray
    length_m: FloatArray
    connected: BoolArray
    cross: FloatArray | None = None
    located: bool = True

    def __len__(self) -> int:
        return len(self.T_map_submap)


@dataclass(frozen=True, slots=True)
class JudgedMeeting:
    """What became of a meeting: chi2 against the solution, 6 degrees of freedom; refused: why it is not used, or empty."""

    meeting: Meeting
    chi2: float
    refused: str


@dataclass(frozen=True, slots=True)
class AlignedDrive:
    """A drive after the city's optimisation.

    T_map_submap  (n, 4, 4); in the drive's own frame where it is not placed
    covariance    (n, 6, 6) of the left perturbation (v, omega); m^2 and rad^2
    shift_m       (n, 3) by how much each submap moved from where its own graph had it; NaN without a place before
    placed        whether it has a place in the map
    """

    drive_id: str
    T_map_submap: FloatArray
    covariance: FloatArray
    shift_m: FloatArray
    placed: bool


@dataclass(frozen=True, slots=True)
class City:
    """Drives by their id, in its order, and judged meetings in canonical order; solved: how many windows were solved now."""

    drives: dict[str, AlignedDrive]
    meetings: list[JudgedMeeting]
    solved: int = 0
    windows: int = 0
    report: dict[str, float] = field(default_factory=dict)
