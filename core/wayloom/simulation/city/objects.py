"""Map ground truth of a city: objects with their positions, area outlines, and changes against another epoch."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle of the city: east and north from low (x, y) to high (x, y), m."""

    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, x: float, y: float) -> bool:
        """Whether a place lies in it."""
        return self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1]


@dataclass(frozen=True, slots=True)
class TrueObject:
    """A pole, a sign or a head of a traffic light.

    class_id  Cityscapes train id
    instance  its number in the instance images
    foot      (3,) ENU m: on the ground under its middle
    bottom_m  height of its lower end above the foot: 0 for a pole
    height_m  height of its upper end above the foot
    """

    class_id: int
    instance: int
    foot: F64
    bottom_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class TrueArea:
    """A surface that is drawn in one class.

    class_id  Cityscapes train id: road, sidewalk or terrain
    ring      (N, 3) ENU m, counter-clockwise, the last point is the first again
    holes     rings of the same form, clockwise, of what is cut out of it
    """

    class_id: int
    ring: F64
    holes: tuple[F64, ...] = ()


@dataclass(frozen=True, slots=True)
class Change:
    """One difference of a changed city.

    what      "removed", "added" or "altered"
    class_id  Cityscapes train id
    instance  its number in the instance images of the city that holds it (of the changed one if both do)
    foot      (3,) ENU m
    """

    what: str
    class_id: int
    instance: int
    foot: F64
