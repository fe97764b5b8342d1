"""A map's tiles are the same bytes on SQLite and on PostgreSQL, 3D tiles too, and count what its regions hold at every level."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from service_kit import postgres
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.layer_names import LAYERS, STATIC
from wayloom.stitching.region_files import decode_region
from wayloom.store import map_versions
from wayloom.store.migrate import upgrade
from wayloom.tiles.cloud_pyramid import top_zoom
from wayloom.tiles.formats import TILE_FORMATS
from wayloom.tiles.gltf_points import decode_glb
from wayloom.tiles.levels import decode_level
from wayloom.tiles.settings import TileSettings
from wayloom_workers.__main__ import make_context
from wayloom_workers.stage_hooks import WorkerContext
from workers.test_stitching import LAT, add, published

TILES = TileSettings(cloud_points_per_tile=250)
"""So small that blocks have tiles below them."""


def service(folder: Path, **more: str) -> WorkerContext:
    made = make_context(WayloomSettings(data_dir=folder, tiles=TILES, **more))
    upgrade(made.database)
    return made


def counts_by_level(context: WorkerContext, layer: str) -> dict[int, NDArray[np.int64]]:
    """Voxels of each class in all tiles of a layer of each zoom; of 3D tiles, down to the blocks."""
    with context.database.read() as session:
        tiles = map_versions.all_current_tiles(session, "city")
    found: dict[int, NDArray[np.int64]] = defaultdict(lambda: np.zeros(19, np.int64))
    for (of, z, _, _), entry in tiles.items():
        if of == layer and z <= TILES.block_zoom:
            data = context.blobs.get(entry.digest)
            found[z] += (decode_glb(data) if layer == "cloud" else decode_level(data)).class_counts()
    return dict(found)


@pytest.mark.postgres
def test_every_tile_is_the_same_on_both_databases_and_counts_are_conserved_at_every_level(
    tmp_path: Path, postgres_folder: str
) -> None:
    one, other = service(tmp_path / "one"), service(tmp_path / "other", database_url=postgres.new_database(postgres_folder))
    for name, seed in (("a", 1), ("b", 2)):
        add(one, name, seed, lat=LAT + 0.0004 * seed)
        in_steps = published(one, tmp_path / f"one {name}")
    for name, seed in (("b", 2), ("a", 1)):
        add(other, name, seed, lat=LAT + 0.0004 * seed)
    at_once = published(other, tmp_path / "other all")
    tiles = at_once["tiles"]
    assert isinstance(tiles, dict)
    assert in_steps["tiles"] == tiles
    assert {layer for layer, *_ in tiles} >= {form.layer for form in TILE_FORMATS.values()}

    with one.database.read() as session:
        regions = map_versions.current_regions(session, "city")
    expected = sum(
        decode_region(one.blobs.get(entry.digest), entry.digest).layers[LAYERS[STATIC]].class_counts() for entry in regions.values()
    )
    cloud, counts = counts_by_level(other, "cloud"), counts_by_level(one, "counts")
    assert set(cloud) == set(range(top_zoom(TILES), TILES.block_zoom + 1))
    assert len(counts) >= 8
    for zoom, found in [*cloud.items(), *counts.items()]:
        assert found.tolist() == np.asarray(expected).tolist(), zoom
    for context in (one, other):
        context.database.close()
