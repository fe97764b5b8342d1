"""Admission of guests to the city graph: drives of uncertain or unknown place, by their meetings with drives that are in.

A guest is tried alone against the drives that are in, so that no two guests vouch for each other, and a guest that is not admitted
moves nobody. Those that earn it come in together, and then help others, round after round. Each round is a function of the sets of
drives and meetings, and so is the end: the order of arrival makes no difference.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.georeference.refusal import DOUBTFUL_SHARE
from wayloom.georeference.report import grade
from wayloom.georeference.uncertainty import position_covariance
from wayloom.stitching.city_graph import CityMemory, optimise_city
from wayloom.stitching.joining import rivals
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import AlignedDrive, City, DrivePlaces, JudgedMeeting, Meeting

FloatArray = NDArray[np.float64]
Merges = Callable[[str], bool]
"""Whether the map takes a drive of this grade."""
ALONE: Final = "it meets no drive of the map"
UNKNOWN: Final = "no place on Earth, nothing in the map looks like it"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a guest is in the map by its meetings, and why, in words.

    grade     A to E by its place in the graph, sigma_m its median over the submaps; None without a place there
    meetings  that the graph believes; drives: with which, sorted
    """

    admitted: bool
    reason: str
    grade: str | None = None
    sigma_m: float | None = None
    meetings: int = 0
    drives: tuple[str, ...] = ()


def admit(
    members: Iterable[DrivePlaces],
    guests: Iterable[DrivePlaces],
    meetings: Sequence[Meeting],
    settings: CityGraphSettings,
    merges: Merges,
) -> tuple[City, dict[str, Verdict]]:
    """The city of the members and of the guests that are admitted, and the verdict on each guest.

    members  drives that are in the map whatever they meet
    meetings of these drives; drives that have none are left out of the city
    Raises InputError as `optimise_city` does.
    """
    inside, asking = {one.drive_id: one for one in members}, {one.drive_id: one for one in guests}
    trials = _Trials(inside | asking, meetings, settings, merges)
    came: set[str] = set()
    city = trials.city(inside)
    verdicts = {name: Verdict(False, ALONE if one.located else UNKNOWN) for name, one in sorted(asking.items())}
    while True:
        present = inside.keys() | came
        tried = {name: trials.verdict(name, present) for name in sorted(asking.keys() - came) if trials.meets(name, present)}
        fit = {name for name, verdict in tried.items() if verdict.admitted}
        fit, city, found = _together(trials, present, came, fit, city)
        verdicts |= tried | found
        if not fit:
            return city, verdicts | {name: trials.judged(name, city) for name in came}
        came |= fit


def _together(
    trials: "_Trials", present: Collection[str], came: set[str], fit: set[str], city: City
) -> tuple[set[str], City, dict[str, Verdict]]:
    """Those that still earn their place when all come at once, the city with them, and the verdicts on those that do not.

    Nobody comes where a guest of an earlier round would lose its place by it.
    """
    fallen: dict[str, Verdict] = {}
    while fit:
        found = trials.city({*present, *fit})
        now = {name: trials.judged(name, found) for name in sorted(fit | came)}
        lost = {name: verdict for name, verdict in now.items() if not verdict.admitted}
        if not lost:
            return fit, found, fallen
        if lost.keys() & came:
            why = "with it a drive that came before loses its place: the two contradict each other"
            return set(), city, fallen | {name: Verdict(False, why) for name in fit}
        fallen |= lost
        fit = fit - lost.keys()
    return set(), city, fallen


class _Trials:
    """Cities of some of the drives; what windows of submaps have in common is solved once."""

    def __init__(
        self, places: dict[str, DrivePlaces], meetings: Sequence[Meeting], settings: CityGraphSettings, merges: Merges
    ) -> None:
        self._places, self._settings, self._merges = places, settings, merges
        self._meetings = [one for one in meetings if one.drive_a in places and one.drive_b in places]
        self._memory = CityMemory()

    def meets(self, name: str, present: Collection[str]) -> bool:
        return any(name in pair and (pair - {name}) <= set(present) for pair in ({m.drive_a, m.drive_b} for m in self._meetings))

    def city(self, present: Collection[str]) -> City:
        """Of those present that meet each other."""
        return self._solved(present, self._memory)

    def verdict(self, name: str, present: Collection[str]) -> Verdict:
        """On a guest alone with those present."""
        memory = CityMemory()
        memory.chains, memory.windows = self._memory.chains, self._memory.windows
        return self.judged(name, self._solved({*present, name}, memory))

    def judged(self, name: str, city: City) -> Verdict:
        """On a guest of this city."""
        mine = [one for one in city.meetings if name in (one.meeting.drive_a, one.meeting.drive_b)]
        placed = city.drives.get(name)
        if placed is None:
            return Verdict(False, ALONE if self._places[name].located else UNKNOWN)
        objection = self._objection_to_place(name, city, placed, mine)
        if objection:
            return Verdict(False, objection)
        return self._by_grade(placed, mine)

    def _objection_to_place(self, name: str, city: City, placed: AlignedDrive, mine: Sequence[JudgedMeeting]) -> str:
        """Why the meetings give no place at all, in words; empty where they do."""
        own = self._places[name]
        believed = [one.meeting for one in mine if not one.refused]
        if not own.located:
            others = rivals(own, city.drives, [one.meeting for one in mine], self._settings)
            if others:
                return others
            if not placed.placed:
                return f"its {len(mine)} meetings do not agree on a place: {self._settings.least_agreeing} must"
            road_m = _road_m(own, believed)
            if road_m < self._settings.least_road_m:
                return f"its meetings agree over {road_m:.0f} m of road only: {self._settings.least_road_m:.0f} m must"
        if len(mine) - len(believed) > DOUBTFUL_SHARE * len(mine):
            return f"{len(mine) - len(believed)} of its {len(mine)} meetings are contradicted by its own place or by other drives"
        if len(believed) < self._settings.least_agreeing:
            return f"{_counted(len(believed), 'meeting')} with the map: {self._settings.least_agreeing} must agree"
        return ""

    def _by_grade(self, placed: AlignedDrive, mine: Sequence[JudgedMeeting]) -> Verdict:
        """By the thresholds of a drive's own grade; a meeting that is not believed is a doubt."""
        sigma2 = np.trace(position_covariance(placed.T_map_submap, placed.covariance), axis1=1, axis2=2)
        sigma_m = float(np.median(np.sqrt(np.maximum(sigma2, 0.0))))
        believed = [one.meeting for one in mine if not one.refused]
        others = tuple(sorted({name for one in believed for name in (one.drive_a, one.drive_b)} - {placed.drive_id}))
        refused = len(mine) - len(believed)
        earned = grade(sigma_m, int(refused > 0))
        words = f"placed by {_counted(len(believed), 'meeting')} with {_counted(len(others), 'drive')}, sigma {sigma_m:.2f} m"
        if refused:
            words += f"; {_counted(refused, 'meeting')} not believed"
        admitted = self._merges(earned)
        reason = words if admitted else f"{words}: grade {earned} is not merged"
        return Verdict(admitted, reason, earned, round(sigma_m, 4), len(believed), others)

    def _solved(self, present: Collection[str], memory: CityMemory) -> City:
        heard = [one for one in self._meetings if one.drive_a in present and one.drive_b in present]
        met = {name for one in heard for name in (one.drive_a, one.drive_b)}
        return optimise_city([self._places[name] for name in sorted(met)], heard, self._settings, memory)


def _road_m(drive: DrivePlaces, meetings: Iterable[Meeting]) -> float:
    """Metres of the drive's submaps that are of these meetings."""
    rows = {one.submap_a if one.drive_a == drive.drive_id else one.submap_b for one in meetings}
    return float(drive.length_m[sorted(rows)].sum())


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
