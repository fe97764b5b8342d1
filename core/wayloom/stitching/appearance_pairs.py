"""Candidates by appearance, for drives whose place is not known: the place index names views that may see the same."""

from dataclasses import dataclass

from wayloom.places.index import PlaceIndex, query_at
from wayloom.places.types import Places
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive


@dataclass(frozen=True, slots=True)
class Appearance:
    """An index of one drive, and the stations of another that ask it."""

    index: PlaceIndex
    asking: Places
    count: int

    def candidates(self, j: int) -> list[int]:
        """Keyframes of the indexed drive that may see what the view at keyframe j sees, the likeliest first."""
        stations = self.asking.stations.keyframe
        if not len(stations):
            return []
        station = int(abs(stations.astype(int) - j).argmin())
        return [found.anchor for found in self.index.candidates(query_at(self.asking, station), self.count)]


def by_appearance(a: PlacedDrive, b: PlacedDrive, settings: MeetingSettings) -> Appearance:
    """What b asks of a."""
    index = PlaceIndex()
    index.add(a.drive_id, a.places)
    return Appearance(index, b.places, settings.candidates)


def likely_drives(index: PlaceIndex, places: Places, count: int) -> list[tuple[str, int]]:
    """Drives of the index that a drive without a place may have met, with the stations that name them first, the most first.

    count : drives at most; the drive itself must not be in the index
    """
    votes: dict[str, int] = {}
    for station in range(len(places.stations)):
        for found in index.candidates(query_at(places, station), 1):
            votes[found.drive_id] = votes.get(found.drive_id, 0) + 1
    return sorted(votes.items(), key=lambda item: (-item[1], item[0]))[:count]
