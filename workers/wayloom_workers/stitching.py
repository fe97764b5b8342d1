"""Stitch stage of the map: the regions that have changed are merged anew, and the tiles that show them cut anew.

What a version is made of depends on which drives are in the map and where they lie, never on which came first: a region is a
function of the submaps that bear on it, a tile of the regions and tracks that it shows.
"""

import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any, Final

from wayloom.config.side_by_side import in_order
from wayloom.pipeline.kernels_ahead import compile_stages
from wayloom.stitching.layer_names import LAYERS, OVERLAYS, STATIC
from wayloom.stitching.region_grid import RegionKey, region_box
from wayloom.store import map_versions, maps
from wayloom.store.map_versions import RegionEntry, TileEntry, TileKey
from wayloom.tiles.feature_tiles import feature_tiles, touched_features
from wayloom.tiles.formats import tile_layer
from wayloom.tiles.ground_tiles import ground_tiles, touched_rasters
from wayloom.tiles.updates import touched_tiles, updated_tiles
from wayloom_workers.ground_source import GroundOfMap
from wayloom_workers.map_source import MapSource, blocks_of_box
from wayloom_workers.map_state import MapState
from wayloom_workers.publishing import TILES_FILE
from wayloom_workers.region_marking import FeaturesOfMap, Marked, marked_regions
from wayloom_workers.region_merging import Merger, RegionParts, aligned_state, changed_regions
from wayloom_workers.stage_hooks import PreparedStage, StageAttempt, key_of_inputs

ALIGNED_SHARE: Final = 0.4
FUSED_SHARE: Final = 0.7
"""Of the progress, when the drives are aligned, and when the regions are merged."""


def prepare_stitch(attempt: StageAttempt) -> PreparedStage:
    """The stage; where many regions have changed, several workers merge them."""
    compile_stages(("stitch",), attempt.progress, threads=attempt.context.settings.threads)
    key = str(attempt.claim.payload["key"]) if attempt.claim.part else key_of_inputs(attempt)
    folder = attempt.context.folders.map(str(attempt.claim.map_id)) / "parts" / "stitch" / key
    parts = RegionParts(attempt, folder)
    return PreparedStage(key, lambda: stitch(attempt, parts.made()), parts.of_stage())


def stitch(attempt: StageAttempt, made: Mapping[RegionKey, RegionEntry] = MappingProxyType({})) -> None:
    """Merge the changed regions, store them and the tiles that show them as blobs, and list both in `tiles.json`.

    made : regions that parts of the stage have merged; one that was made from other submaps than there are by now does not count
    """
    state = aligned_state(attempt)
    merged = _merged_regions(attempt, state, made)
    ground = GroundOfMap(attempt, state, {entry.key: entry for entry in merged.made}, merged.dropped)
    marked = marked_regions(attempt, state, merged.made, merged.dropped, merged.ground_changed, ground)
    tiles, dropped_tiles = _cut_tiles(attempt, state, merged, ground, marked)
    content: dict[str, Any] = {
        "base": state.base,
        "frame": [state.frame.lon_deg, state.frame.lat_deg, state.frame.height_m],
        "built_with": state.built_with,
        "drives": list(state.drives),
        "out_of_reach": list(state.out_of_reach),
        "submaps": len(state.submaps),
        "moved": [asdict(one) for one in state.moved.values()],
        "facts": dict(state.facts),
        "verdicts": {name: asdict(verdict) for name, verdict in sorted(state.verdicts.items())},
        "bounds": state.bounds,
        "taken_in": sorted(state.boxes),
        "tiles": [asdict(entry) for entry in tiles],
        "dropped_tiles": dropped_tiles,
        "regions": [asdict(entry) for entry in marked.regions],
        "dropped_regions": merged.dropped,
    }
    (attempt.out_dir / TILES_FILE).write_text(json.dumps(content) + "\n", encoding="utf-8")


@dataclass(frozen=True, slots=True)
class _Merged:
    """made     regions that are new or made from other submaps than before
    dropped      those that are no more; ground_changed: those of both whose ground is another than before
    """

    made: list[RegionEntry]
    dropped: list[RegionKey]
    ground_changed: list[RegionKey]


def _merged_regions(attempt: StageAttempt, state: MapState, ready: Mapping[RegionKey, RegionEntry]) -> _Merged:
    """The regions that have changed."""
    keys = changed_regions(state)
    with attempt.context.database.read() as session:
        kept = map_versions.current_regions(session, str(attempt.claim.map_id), None if state.whole else keys)
    merger = Merger(attempt, state)
    made: list[RegionEntry] = []
    gone = sorted(kept.keys() - set(keys)) if state.whole else []

    def merge(key: RegionKey) -> RegionEntry | None:
        rows = merger.rows(key)
        inputs = merger.inputs(rows)
        for there in (kept.get(key), ready.get(key)):
            if rows and there is not None and there.inputs == inputs:
                return there
        return merger.region(key, rows, inputs) if rows else None

    for count, (key, entry) in enumerate(zip(keys, in_order(merge, keys, attempt.context.settings.threads), strict=True)):
        attempt.progress(ALIGNED_SHARE + (FUSED_SHARE - ALIGNED_SHARE) * count / len(keys), f"region {count + 1} of {len(keys)}")
        if entry is None and key in kept:
            gone.append(key)
        elif entry is not None and entry is not kept.get(key):
            made.append(entry)
    ground = {key: entry.ground for key, entry in kept.items() if not state.whole}
    changed = [entry.key for entry in made if entry.ground != ground.get(entry.key, "")]
    return _Merged(made, gone, [*changed, *(key for key in gone if ground.get(key))])


def _cut_tiles(
    attempt: StageAttempt, state: MapState, merged: _Merged, ground: GroundOfMap, marked: Marked
) -> tuple[list[TileEntry], list[TileKey]]:
    """The tiles that are new or other than before, and the addresses of those that have nothing to show any more."""
    settings = attempt.context.settings.tiles
    source = MapSource(attempt, state, {entry.key: entry.digest for entry in merged.made}, merged.dropped)
    squares = [*(entry.key for entry in merged.made), *merged.dropped]
    places = [*state.changed, *(region_box(key, state.frame, around_m=0.0) for key in squares)]
    changed = set().union(*(blocks_of_box(box, settings) for box in places))
    sources = {LAYERS[STATIC]: source} | {of: source.overlay(of) for of in OVERLAYS}
    with attempt.context.database.read() as session:
        had = maps.version(session, str(attempt.claim.map_id), state.base).layers if state.base else {}
        of_map = [
            of for of, one in sources.items() if of == LAYERS[STATIC] or tile_layer("png", of) in had or one.is_in_new_regions()
        ]
        if state.whole:
            before = map_versions.all_current_tiles(session, str(attempt.claim.map_id))
        else:
            touched = [scope for of in of_map for scope in touched_tiles(changed, settings, of).items()]
            touched += touched_rasters(merged.ground_changed, state.frame, settings).items()
            touched += touched_features(marked.changed, state.frame, settings).items()
            keys = [(layer, *address) for (layer, _), addresses in touched for address in addresses]
            before = map_versions.current_tiles(session, str(attempt.claim.map_id), keys)
    shown: dict[TileKey, TileEntry] = {}
    points = (tile for of in of_map for tile in updated_tiles(changed, sources[of], settings, of))
    pictures = ground_tiles(merged.ground_changed, ground, state.frame, settings, attempt.context.settings.threads)
    features = feature_tiles(marked.changed, FeaturesOfMap(attempt, state, marked.regions, merged.dropped), state.frame, settings)
    for count, tile in enumerate(itertools.chain(points, pictures, features)):
        digest = attempt.context.blobs.put(tile.data)
        entry = TileEntry(tile.layer, tile.z, tile.x, tile.y, digest, tile.media_type, len(tile.data))
        shown[entry.key] = entry
        attempt.progress(FUSED_SHARE + (1.0 - FUSED_SHARE) * (1.0 - 0.5 ** (count / 200.0)), f"{count + 1} tiles")
    new = [entry for key, entry in sorted(shown.items()) if key not in before or before[key].digest != entry.digest]
    return new, sorted(before.keys() - shown.keys())
