"""Epochs of a rig: its drives by the time of recording, split where one contradicts those before it beyond chance.

A drive that contradicts the epoch before it begins a new one. If the next drive agrees with the old epoch again, that drive was a
lone stray and the old epoch goes on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar


class Dated(Protocol):
    """Evidence of one drive: its name, and when it was recorded."""

    @property
    def drive_id(self) -> str: ...

    @property
    def t_ns(self) -> int: ...


D = TypeVar("D", bound=Dated)


@dataclass(frozen=True, slots=True)
class Epoch(Generic[D]):
    """A stretch of a rig's life in which its drives agree.

    drives      by the time of recording
    chi_square  by which the first one contradicts the epoch before; None for the first epoch
    stray       one drive that agrees with nothing before and nothing after
    """

    drives: tuple[D, ...]
    chi_square: float | None = None
    stray: bool = False

    @property
    def from_ns(self) -> int:
        """When its first drive was recorded."""
        return self.drives[0].t_ns

    @property
    def ids(self) -> tuple[str, ...]:
        """Names of its drives."""
        return tuple(drive.drive_id for drive in self.drives)


def split(drives: Sequence[D], contradiction: Callable[[D, Epoch[D]], float], beyond_chance: float) -> list[Epoch[D]]:
    """The epochs of a rig, by time; each drive is in one of them.

    contradiction : chi-square of a drive against an epoch; beyond_chance : from which on it contradicts it
    """
    closed: list[Epoch[D]] = []
    strays: list[Epoch[D]] = []
    now: Epoch[D] | None = None
    for drive in sorted(drives, key=lambda one: (one.t_ns, one.drive_id)):
        against = 0.0 if now is None else contradiction(drive, now)
        if now is None:
            now = Epoch((drive,))
        elif against <= beyond_chance:
            now = replace(now, drives=(*now.drives, drive))
        elif len(now.drives) == 1 and closed and contradiction(drive, closed[-1]) <= beyond_chance:
            strays.append(replace(now, stray=True))
            now = closed.pop()
            now = replace(now, drives=(*now.drives, drive))
        else:
            closed.append(now)
            now = Epoch((drive,), against)
    return sorted([*closed, *strays, *([] if now is None else [now])], key=lambda epoch: (epoch.from_ns, epoch.ids))
