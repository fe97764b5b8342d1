"""Build context of one block: random stream, mesh, recorded objects, and the changes of its objects in a changed city."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.instance_ids import THINGS_PER_BLOCK
from wayloom.simulation.city.objects import Change, TrueObject
from wayloom.simulation.city.streets import F64, BlockShape, StreetGraph
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.models.mesh import MeshBuilder

POLE, SIGN, LIGHT = CLASS_ID["pole"], CLASS_ID["traffic sign"], CLASS_ID["traffic light"]
CHANGE_SHARES = {"sign": (0.16, 0.12), "pole": (0.08, 0.05), "vehicle": (0.30, 0.25)}
"""In a changed city: shares of the objects of a kind that are removed, and that are moved (vehicles: replaced by another)."""
MOVED_M = 1.7


class ChangeState(Enum):
    """State of an object in a changed city against the unchanged one."""

    UNCHANGED = 0
    REMOVED = 1
    MOVED = 2


@dataclass(frozen=True, slots=True)
class SignalFace:
    """Lamps of one signal head at (3,) m over the flat city, facing (2,), for traffic from node `origin` to `node`."""

    at: F64
    facing: F64
    node: int
    origin: int
    number: int


@dataclass(slots=True)
class BlockContext:
    """State shared by the builders of one block. rng is the random stream of the stage being built.

    Noted things have their feet on a flat city: the city lifts them onto its hills.
    """

    m: MeshBuilder
    graph: StreetGraph
    shape: BlockShape
    models: Models
    rng: np.random.Generator
    first_number: int
    change_rng: np.random.Generator | None = None
    repaint: np.random.Generator | None = None
    numbers_given: int = 0
    objects: list[TrueObject] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    faces: list[SignalFace] = field(default_factory=list)

    def number(self) -> int:
        """The next instance number of this block; the last one again where there are no more."""
        self.numbers_given = min(self.numbers_given + 1, THINGS_PER_BLOCK)
        return self.first_number + self.numbers_given - 1

    def note(self, class_id: int, number: int, at: F64, bottom_m: float, top_m: float) -> None:
        """Record an object over the sidewalk at (2,) m, from bottom_m to top_m above the street's plane."""
        foot = np.array([at[0], at[1], KERB_M])
        self.objects.append(TrueObject(class_id, number, foot, max(0.0, bottom_m - KERB_M), top_m - KERB_M))

    def draw_change(self, kind: str) -> ChangeState:
        """Draw the change state of the next object of a kind."""
        if self.change_rng is None:
            return ChangeState.UNCHANGED
        gone, elsewhere = CHANGE_SHARES[kind]
        chance = self.change_rng.random()
        return ChangeState.REMOVED if chance < gone else ChangeState.MOVED if chance < gone + elsewhere else ChangeState.UNCHANGED

    def kerb_point(self, k: int, along_m: float, in_m: float) -> F64:
        """(2,) m, the point `along_m` along street edge k from its node and `in_m` behind the kerb (negative: on the road)."""
        d, inward, _ = self.shape.edge(k)
        return np.asarray(self.shape.middle[k] + d * along_m + inward * (self.shape.half_m[k] + in_m))

    def places_after_change(self, state: ChangeState, class_id: int, number: int, at: F64, along: F64) -> list[F64]:
        """Places of an object after its change, (2,) m each, none where it is removed; records the change."""
        new = [] if state is ChangeState.REMOVED else [at + along * MOVED_M] if state is ChangeState.MOVED else [at]
        if state is not ChangeState.UNCHANGED:
            self.changes.append(Change("removed", class_id, number, np.array([*at, KERB_M])))
            self.changes += [Change("added", class_id, number, np.array([*place, KERB_M])) for place in new]
        return new
