"""Markings and kerbs of a stitch: found anew where the ground of a region, or of one beside it, has changed."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

from wayloom.stitching.marking_files import read_features
from wayloom.stitching.region_grid import RegionKey
from wayloom.stitching.region_markings import neighbourhood, region_markings
from wayloom.store.map_versions import RegionEntry, current_regions
from wayloom_workers.ground_source import GroundOfMap
from wayloom_workers.map_state import MapState
from wayloom_workers.region_entries import RegionEntries
from wayloom_workers.stage_hooks import StageAttempt

HELD_FILES: Final = 256


@dataclass(frozen=True, slots=True)
class Marked:
    """regions   that the stitch has made, with their markings, and those that it has kept whose markings are other ones now
    changed   the regions with other markings than before, those that are no more among them, sorted
    """

    regions: list[RegionEntry]
    changed: list[RegionKey]


def marked_regions(
    attempt: StageAttempt,
    state: MapState,
    made: Sequence[RegionEntry],
    dropped: Collection[RegionKey],
    ground_changed: Collection[RegionKey],
    ground: GroundOfMap,
) -> Marked:
    """The regions with their markings.

    made, dropped  : regions that this stitch has made, and those that are no more
    ground_changed : of these those whose ground is another than before
    """
    scope = sorted({near for key in ground_changed for near in neighbourhood(key)})
    ours = {entry.key: entry for entry in made}
    kept: dict[RegionKey, RegionEntry] = {}
    if not state.whole:
        with attempt.context.database.read() as session:
            kept = current_regions(session, str(attempt.claim.map_id), {*scope, *ours, *dropped})
    there = ours.keys() | (kept.keys() - set(dropped))
    fresh = {key: _stored(attempt, state, key, ground) for key in scope if key in there}
    before = {key: entry.markings for key, entry in kept.items()}
    regions = [replace(entry, markings=fresh.get(key, before.get(key, ""))) for key, entry in ours.items()]
    regions += [replace(kept[key], markings=fresh[key]) for key in fresh if key not in ours and fresh[key] != before[key]]
    changed = {entry.key for entry in regions if entry.markings != before.get(entry.key, "")}
    return Marked(regions, sorted(changed | {key for key in dropped if before.get(key)}))


def _stored(attempt: StageAttempt, state: MapState, key: RegionKey, ground: GroundOfMap) -> str:
    """The digest of a region's markings; empty where it has none."""
    settings = attempt.context.settings
    data = region_markings(key, ground, state.frame, settings.markings, settings.kerbs)
    return "" if data is None else attempt.context.blobs.put(data)


class MarkingsOfMap:
    """`wayloom.tiles.marking_tiles.MarkingSource` of one stitch.

    regions  of `Marked`; dropped: those that are no more
    """

    def __init__(
        self, attempt: StageAttempt, state: MapState, regions: Sequence[RegionEntry], dropped: Collection[RegionKey]
    ) -> None:
        self._entries = RegionEntries(attempt, state, {entry.key: entry for entry in regions}, dropped)
        self._read = lru_cache(HELD_FILES)(lambda digest: read_features(attempt.context.blobs.get(digest), digest))

    def features(self, key: RegionKey) -> Sequence[Mapping[str, Any]]:
        """Of a region."""
        entry = self._entries.at(key)
        return self._read(entry.markings) if entry is not None and entry.markings else ()
