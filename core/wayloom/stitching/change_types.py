"""Changes of the map: things that have gone or are new, with the drives that are the evidence."""

from dataclasses import dataclass
from typing import Final

KINDS: Final = ("gone", "new")


@dataclass(frozen=True, slots=True)
class Change:
    """A thing that has gone or is new.

    kind          one of KINDS
    label         train id of most of its points
    position_enu  m in the map's frame: the middle of its points; extent_m how far they reach east, north and up
    points        how many
    first_seen_ns, last_seen_ns  by the drives `seen_by` (sorted ids), in `seen` looks and by points
    first_through_ns, last_through_ns  of the `through` looks of the drives `through_by` that say that nothing is there
    """

    kind: str
    label: int
    position_enu: tuple[float, float, float]
    extent_m: tuple[float, float, float]
    points: int
    seen_by: tuple[str, ...]
    seen: int
    first_seen_ns: int
    last_seen_ns: int
    through_by: tuple[str, ...]
    through: int
    first_through_ns: int
    last_through_ns: int
