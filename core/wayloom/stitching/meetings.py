"""Registration between drives: where two drives saw the same street, as measured relative poses of their submaps.

What comes out depends on the two drives' own files alone, so it can be kept under their digests and is never computed anew when
other drives come or go.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from wayloom.errors import StageError
from wayloom.loops.priors import Closure
from wayloom.registration.register import Prior
from wayloom.stitching.agreement import agreeing, one_place
from wayloom.stitching.appearance_pairs import by_appearance, guess
from wayloom.stitching.located_pairs import near_by_place, prior_of_places
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.submap_meetings import meetings_of
from wayloom.stitching.types import Meeting
from wayloom.stitching.view_pairs import PairSearch, search_pairs, start_search


@dataclass(frozen=True, slots=True)
class DriveMeetings:
    """Meetings of two drives, and JSON-ready facts: pairs of views tried, fitting, accepted, and why others were refused."""

    meetings: tuple[Meeting, ...]
    report: dict[str, Any]


def find_meetings(one: PlacedDrive, other: PlacedDrive, settings: MeetingSettings = MeetingSettings()) -> DriveMeetings:
    """All meetings of two drives, the same whichever is named first; a is the drive with the lesser id.

    Raises StageError where both are one drive, or are placed in different frames.
    """
    a, b = sorted((one, other), key=lambda drive: drive.drive_id)
    check_pair(a, b)
    return found_meetings(start_search(a, b, settings))[0]


def found_meetings(search: PairSearch) -> tuple[DriveMeetings, list[Closure]]:
    """What a search that has just begun finds, and the pairs of views that it rests on."""
    a, b = search.a, search.b
    pairs, refused = pairs_by_place(search) if a.is_located and b.is_located else pairs_by_appearance(search)
    found = meetings_of(a, b, pairs, search.settings)
    return DriveMeetings(tuple(found), report(search, len(pairs), len(found), refused)), pairs


def check_pair(a: PlacedDrive, b: PlacedDrive) -> None:
    """Raises StageError where two drives cannot be compared."""
    if a.drive_id == b.drive_id:
        raise StageError(f"drive {a.drive_id} is compared with itself: its own loops are found by the stage loops")
    if a.is_located and b.is_located and a.submaps[0].frame != b.submaps[0].frame:
        raise StageError(
            f"drive {a.drive_id} lies in the frame {a.submaps[0].frame}, drive {b.drive_id} in {b.submaps[0].frame}: "
            "geo-reference them in one frame"
        )


def pairs_by_place(search: PairSearch) -> tuple[list[Closure], dict[str, int]]:
    """Pairs of views where GNSS places both drives, and why others were refused."""
    a, b, settings = search.a, search.b, search.settings

    def candidates(j: int) -> list[tuple[int, Callable[[], Prior]]]:
        return [(i, partial(prior_of_places, a, b, i, j)) for i in near_by_place(a, b, search.anchors, j, settings)]

    search_pairs(search, candidates)
    return agreeing(search, settings.least_agreeing)


def pairs_by_appearance(search: PairSearch) -> tuple[list[Closure], dict[str, int]]:
    """Pairs of views where one drive does not know its place, and why others were refused."""
    asked = by_appearance(search.a, search.b, search.settings)

    def candidates(j: int) -> list[tuple[int, Callable[[], Prior]]]:
        return [(i, partial(guessed, search, i, j, yaw)) for i, yaw in asked.candidates(j)]

    search_pairs(search, candidates, are_guesses=True)
    pairs, refused = agreeing(search, search.settings.least_agreeing_alone)
    pairs, more = one_place(search, pairs)
    return pairs, refused | more


def guessed(search: PairSearch, i: int, j: int, yaw_rad: float) -> Prior:
    """T_i_j of the cameras of two views that may see one place, by the index."""
    return guess(search.scene(0, i), search.scene(1, j), yaw_rad)


def report(search: PairSearch, accepted: int, meetings: int, refused: dict[str, int]) -> dict[str, Any]:
    """JSON-ready; numbers are left out of the words of refusals, so that like ones are counted together."""
    words = Counter("".join(c for c in text if not c.isdigit()) for text in search.tried.values() if text)
    return {
        "tried": len(search.tried),
        "fitting": len(search.found),
        "accepted": accepted,
        "meetings": meetings,
        "refused": dict(sorted(words.items())),
        "refused_together": dict(sorted(refused.items())),
    }
