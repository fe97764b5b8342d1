"""Voxels a second through the whole tile pyramid, by format, and how much faster its counts are than the naive twin of the tests.

python benchmarks/tiles.py [--voxels 200000] [--json FILE]
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "tiles"))

from made_maps import made_map, made_tracks
from test_tile_pyramid import lon_lat, naive_counts

from wayloom.tiles.levels import coarser, finest_level
from wayloom.tiles.pyramid import build_tiles


def main() -> None:
    """Measure, print, write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--voxels", type=int, default=200_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    city, few = made_map(options.voxels), made_map(2000)
    tracks = made_tracks(city)
    sizes: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    for tile in build_tiles(city, city.frame, tracks=tracks):
        sizes[tile.layer] += len(tile.data)
        counts[tile.layer] += 1
    whole = seconds(lambda: list(build_tiles(city, city.frame, tracks=tracks)))
    levels = options.voxels / seconds(lambda: _levels(lon_lat(city), city.label))
    naive = len(few) / seconds(lambda: [naive_counts(few, zoom) for zoom in range(20, 11, -1)])
    result = {
        "voxels_per_second": options.voxels / whole,
        "tiles": dict(counts),
        "bytes_per_voxel": {layer: size / len(city) for layer, size in sizes.items()},
        "levels_voxels_per_second": levels,
        "naive_levels_voxels_per_second": naive,
        "ratio": levels / naive,
    }
    print(f"all tiles {result['voxels_per_second']:.3g} voxels/s ({dict(counts)} tiles)")
    print(f"counts of nine zooms {levels:.3g} voxels/s, naive twin {naive:.3g} voxels/s, ratio {levels / naive:.0f}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def _levels(places, label) -> None:  # type: ignore[no-untyped-def]
    level = finest_level(places, label, 20)
    for _ in range(8):
        level = coarser(level)


def seconds(work: Callable[[], object]) -> float:
    """Wall time of the best of three runs."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    main()
