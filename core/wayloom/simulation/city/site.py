"""Build context of one block: random stream, mesh, recorded objects, and the changes of its objects in a changed city."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.numbering import THINGS_PER_BLOCK
from wayloom.simulation.city.objects import Change, TrueObject
from wayloom.simulation.city.streets import F64, BlockShape, StreetGraph
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.models.mesh import MeshBuilder

POLE, SIGN, LIGHT = CLASS_ID["pole"], CLASS_ID["traffic sign"], CLASS_ID["traffic light"]
CHANGED_SHARES = {"sign": (0.16, 0.12), "pole": (0.08, 0.05), "vehicle": (0.30, 0.25)}
"""In a changed city: how many things of a kind are gone, and how many are elsewhere (vehicles: another one stands there)."""
MOVED_M = 1.7


class Fate(Enum):
    """What has become of a thing in a changed city."""

    KEPT = 0
    GONE = 1
    ELSEWHERE = 2


@dataclass(frozen=True, slots=True)
class SignalFace:
    """The lamps of one signal head: at (3,) m over the flat city, facing (2,), for who comes from node `origin` to `node`."""

    at: F64
    facing: F64
    node: int
    origin: int
    number: int


@dataclass(slots=True)
class Site:
    """What the builders of one block share. rng is that of the stage being built; fates and repaint are None in an unchanged city.

    Noted things have their feet on a flat city: the city lifts them onto its hills.
    """

    m: MeshBuilder
    graph: StreetGraph
    shape: BlockShape
    models: Models
    rng: np.random.Generator
    first_number: int
    fates: np.random.Generator | None = None
    repaint: np.random.Generator | None = None
    given: int = 0
    objects: list[TrueObject] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    faces: list[SignalFace] = field(default_factory=list)

    def number(self) -> int:
        """A number that no other thing of this block has; the last one again where there are no more."""
        self.given = min(self.given + 1, THINGS_PER_BLOCK)
        return self.first_number + self.given - 1

    def note(self, class_id: int, number: int, at: F64, bottom_m: float, top_m: float) -> None:
        """Remember an object over the sidewalk at (2,) m, from bottom_m to top_m above the street's plane."""
        foot = np.array([at[0], at[1], KERB_M])
        self.objects.append(TrueObject(class_id, number, foot, max(0.0, bottom_m - KERB_M), top_m - KERB_M))

    def fate(self, kind: str) -> Fate:
        """What has become of the next thing of a kind."""
        if self.fates is None:
            return Fate.KEPT
        gone, elsewhere = CHANGED_SHARES[kind]
        chance = self.fates.random()
        return Fate.GONE if chance < gone else Fate.ELSEWHERE if chance < gone + elsewhere else Fate.KEPT

    def kerb_point(self, k: int, along_m: float, in_m: float) -> F64:
        """A place `along_m` m along street edge k from its node and `in_m` m behind the kerb (negative: on the road)."""
        d, inward, _ = self.shape.edge(k)
        return np.asarray(self.shape.middle[k] + d * along_m + inward * (self.shape.half_m[k] + in_m))

    def places_after(self, fate: Fate, class_id: int, number: int, at: F64, along: F64) -> list[F64]:
        """Where a thing stands after its fate, if at all; notes the change."""
        new = [] if fate is Fate.GONE else [at + along * MOVED_M] if fate is Fate.ELSEWHERE else [at]
        if fate is not Fate.KEPT:
            self.changes.append(Change("removed", class_id, number, np.array([*at, KERB_M])))
            self.changes += [Change("added", class_id, number, np.array([*place, KERB_M])) for place in new]
        return new
