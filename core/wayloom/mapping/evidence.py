"""Evidence on a drive's poses besides odometry and GNSS: loop closures and directions of up."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.loop_factors import LoopLinks, no_loop_links
from wayloom.mapping.up_factors import UpObservations, nothing_of_up

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Closures between nodes of a drive and what was seen of up at them."""

    loops: LoopLinks = field(default_factory=no_loop_links)
    up: UpObservations = field(default_factory=nothing_of_up)

    def nodes(self) -> IntArray:
        """Rows of the nodes of which anything is said."""
        return np.unique(np.concatenate([self.loops.first, self.loops.second, self.up.node]))

    def at(self, nodes: IntArray) -> "Evidence":
        """The same over some of the nodes, those of which anything is said among them."""
        return Evidence(self.loops.at(nodes), self.up.at(nodes))
