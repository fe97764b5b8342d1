"""Regions of a map as a stitch leaves them: its own, and those of the version before that it keeps."""

from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Final

from wayloom.stitching.region_grid import RegionKey
from wayloom.store.map_versions import RegionEntry, current_regions
from wayloom_workers.map_state import MapState
from wayloom_workers.stage_hooks import StageAttempt

HELD_ENTRIES: Final = 1024


class RegionEntries:
    """The region at a key, found once.

    made     regions that this stitch has made; dropped: those that are no more
    """

    def __init__(
        self, attempt: StageAttempt, state: MapState, made: Mapping[RegionKey, RegionEntry], dropped: Collection[RegionKey]
    ) -> None:
        self._database, self._map_id = attempt.context.database, str(attempt.claim.map_id)
        self._has_base = bool(state.base) and not state.whole
        self._made, self._dropped = made, frozenset(dropped)
        self.at = lru_cache(HELD_ENTRIES)(self._found)

    def _found(self, key: RegionKey) -> RegionEntry | None:
        if key in self._made:
            return self._made[key]
        if not self._has_base or key in self._dropped:
            return None
        with self._database.read() as session:
            return current_regions(session, self._map_id, [key]).get(key)
