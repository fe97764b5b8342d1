"""Features of a stitch, by regions.

Markings, kerbs and areas are found anew where the ground of a region, or of one beside it, has changed; objects come with the
regions that were made.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

from wayloom.config.side_by_side import in_order
from wayloom.stitching.ground_mosaic import neighbourhood
from wayloom.stitching.marking_files import read_features
from wayloom.stitching.region_areas import region_areas
from wayloom.stitching.region_grid import RegionKey
from wayloom.stitching.region_markings import region_markings
from wayloom.store.map_versions import REGION_FEATURES, RegionEntry, current_regions
from wayloom_workers.ground_source import GroundOfMap
from wayloom_workers.map_state import MapState
from wayloom_workers.region_entries import RegionEntries
from wayloom_workers.stage_hooks import StageAttempt

HELD_FILES: Final = 256
OF_GROUND: Final = ("markings", "areas")
"""The features that are found on the ground."""


@dataclass(frozen=True, slots=True)
class Marked:
    """regions   that the stitch has made, with their features, and those that it has kept whose features are other ones now
    changed   for each kind of REGION_FEATURES the regions with others than before, those that are no more among them, sorted
    """

    regions: list[RegionEntry]
    changed: dict[str, list[RegionKey]]


def marked_regions(
    attempt: StageAttempt,
    state: MapState,
    made: Sequence[RegionEntry],
    dropped: Collection[RegionKey],
    ground_changed: Collection[RegionKey],
    ground: GroundOfMap,
) -> Marked:
    """The regions with their features.

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
    keys = [key for key in scope if key in there]
    found = in_order(lambda key: _found(attempt, state, key, ground), keys, attempt.context.settings.threads)
    fresh = dict(zip(keys, found, strict=True))
    before = {key: {of: getattr(entry, of) for of in REGION_FEATURES} for key, entry in kept.items()}
    nothing = dict.fromkeys(REGION_FEATURES, "")
    unseen = dict.fromkeys(OF_GROUND, "")
    as_before = {key: {of: found[of] for of in OF_GROUND} for key, found in before.items()}
    regions = [_with(entry, fresh.get(key, as_before.get(key, unseen))) for key, entry in ours.items()]
    regions += [_with(kept[key], fresh[key]) for key in fresh if key not in ours and fresh[key] != as_before[key]]
    changed = {of: {one.key for one in regions if getattr(one, of) != before.get(one.key, nothing)[of]} for of in REGION_FEATURES}
    gone = {of: {key for key in dropped if before.get(key, nothing)[of]} for of in REGION_FEATURES}
    return Marked(regions, {of: sorted(changed[of] | gone[of]) for of in REGION_FEATURES})


def _with(entry: RegionEntry, found: Mapping[str, str]) -> RegionEntry:
    """The region with these digests of its features of OF_GROUND."""
    return replace(entry, markings=found["markings"], areas=found["areas"])


def _found(attempt: StageAttempt, state: MapState, key: RegionKey, ground: GroundOfMap) -> dict[str, str]:
    """The digests of the features of OF_GROUND of a region; empty where it has none."""
    settings = attempt.context.settings
    found = {
        "markings": region_markings(key, ground, state.frame, settings.markings, settings.kerbs),
        "areas": region_areas(key, ground, state.frame, settings.areas),
    }
    return {of: "" if data is None else attempt.context.blobs.put(data) for of, data in found.items()}


class FeaturesOfMap:
    """`wayloom.tiles.feature_tiles.FeatureSource` of one stitch.

    regions  of `Marked`; dropped: those that are no more
    """

    def __init__(
        self, attempt: StageAttempt, state: MapState, regions: Sequence[RegionEntry], dropped: Collection[RegionKey]
    ) -> None:
        self._entries = RegionEntries(attempt, state, {entry.key: entry for entry in regions}, dropped)
        self._read = lru_cache(HELD_FILES)(lambda digest: read_features(attempt.context.blobs.get(digest), digest))

    def features(self, of: str, key: RegionKey) -> Sequence[Mapping[str, Any]]:
        """Of a kind and a region."""
        entry = self._entries.at(key)
        digest = "" if entry is None else getattr(entry, of)
        return self._read(digest) if digest else ()
