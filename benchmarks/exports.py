"""CPU and memory of each export format, on made maps of a few sizes: memory must not grow with the map."""

import argparse
import multiprocessing
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from wayloom.exports.formats import EXPORT_FORMATS, Export, export_map
from wayloom.exports.provenance import provenance_of
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import map_frame_for
from wayloom.stitching.region_grid import REGION_M, RegionKey
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.pyramid import Track

FORMATS = ("laz", "copc", "ply", "parquet", "3dtiles", "pmtiles")
POINTS_A_REGION = 50_000
"""About what a street of the simulated city has with five drives."""


class MadeStreets:
    """A source whose regions are made when they are asked for: nothing of it is in memory."""

    def __init__(self, regions: int) -> None:
        self.frame, self.voxel_m = map_frame_for(8.4, 49.0), 0.1
        centre = wgs84.enu_from_lonlatheight(np.array([[8.4, 49.0, 110.0]]), self.frame)[0]
        self.place = centre
        east, north = (centre[:2] // REGION_M).astype(int).tolist()
        side = int(np.ceil(np.sqrt(regions)))
        self.keys: list[RegionKey] = sorted((east + k % side, north + k // side) for k in range(regions))
        self._known = frozenset(self.keys)

    def voxels(self, key: RegionKey) -> VoxelMap | None:
        if key not in self._known:
            return None
        rng = np.random.default_rng([key[0] % 1000, key[1] % 1000])
        n = POINTS_A_REGION
        low = np.array([*(np.array(key) * REGION_M), self.place[2] - 1.0])
        ground = rng.random(n) < 0.6
        height = np.where(ground, rng.normal(0.0, 0.02, n), rng.uniform(0.0, 12.0, n))
        points = low + np.column_stack([rng.uniform(0.0, REGION_M, (n, 2)), height])
        label = np.where(ground, rng.choice([0, 1, 9], n), rng.choice([2, 5, 8], n)).astype(np.uint8)
        votes = np.zeros((n, 19), np.float32)
        votes[np.arange(n), label] = 1.0
        seen = np.full(n, 1_700_000_000 * 10**9) + rng.integers(0, 10**12, n)
        start, drive = np.arange(n + 1), np.zeros(n, np.int32)
        keys, grey = np.floor(points / 0.1).astype(np.int32), rng.integers(0, 256, n).astype(np.uint8)
        sigma = np.full(n, 0.05, np.float32)
        count = np.ones(n, np.uint32)
        return VoxelMap(self.frame, 0.1, keys, points, grey, sigma, votes, label, count, start, drive, seen, seen, ("made",))

    def raster(self, key: RegionKey, name: str) -> None:
        return None

    def place_sigma_mm(self, key: RegionKey) -> Any:
        return np.zeros(0, np.uint16)

    def features(self, name: str, key: RegionKey) -> tuple[()]:
        return ()

    def tracks(self) -> Any:
        return iter([Track("made", self.place + np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]]))])

    def doubts(self) -> dict[str, Any]:
        return {}

    def provenance(self) -> dict[str, Any]:
        return provenance_of("made", [{"id": "made"}], self.frame, {}, "")


def measured(name: str, regions: int, out: Path, answer: Any) -> None:
    """Write once in a process of its own: CPU s of writing and of making the regions, MB beyond the start, bytes."""
    source = MadeStreets(regions)
    layers = ("points",) if name == "parquet" else ()
    export_map(Export(MadeStreets(1), out / "warm", layers=layers), name)
    start = time.process_time()
    for key in source.keys:
        source.voxels(key)
    made_s = time.process_time() - start
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    start = time.process_time()
    export_map(Export(source, out / "map", layers=layers), name)
    spent_s = time.process_time() - start
    after_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    path = out / "map"
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) if path.is_dir() else path.stat().st_size
    answer.put((spent_s, made_s, after_mb - before_mb, size))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--regions", type=int, nargs="+", default=[20, 80], help="sizes of the made maps, regions of 50,000 points")
    parser.add_argument("--formats", nargs="+", default=FORMATS, choices=EXPORT_FORMATS)
    arguments = parser.parse_args()
    sizes = arguments.regions
    heads = [f"{regions * POINTS_A_REGION / 1e6:g} M: CPU s a million, MB more" for regions in sizes]
    print(f"| format | {' | '.join(heads)} | bytes a point |\n| --- |{' --- |' * (len(sizes) + 1)}")
    for name in arguments.formats:
        cells, size = [], 0
        for regions in sizes:
            with tempfile.TemporaryDirectory() as folder:
                answer: Any = multiprocessing.get_context("spawn").Queue()
                child = multiprocessing.get_context("spawn").Process(target=measured, args=(name, regions, Path(folder), answer))
                child.start()
                spent_s, made_s, more_mb, size = answer.get()
                child.join()
            millions = regions * POINTS_A_REGION / 1e6
            once = max(spent_s - made_s, 0.0)
            cells.append(f"{once / millions:.1f}, {more_mb:.0f}")
        print(f"| `{name}` | {' | '.join(cells)} | {size / (sizes[-1] * POINTS_A_REGION):.1f} |", flush=True)


if __name__ == "__main__":
    main()
