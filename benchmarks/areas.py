"""Areas of the ground measured: road, sidewalk and terrain of simulated drives against what the truth images show.

python benchmarks/areas.py OUT LOG [OUT LOG ...] [--write NAME]   OUT of `wayloom process`, LOG simulated with --truth

The sheets that OUT holds are merged region by region as a map does it, each at the place that the true poses of its keyframes
give it, and areas are found as in a map. --write NAME: the table into docs/benchmarks/areas.md.
"""

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pages import DOCS, put_between_marks
from wayloom.evaluation.areas import NONE, AreaScores, score_areas
from wayloom.evaluation.ground import NEAR_TRACK_M, true_ground, true_place
from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.ground_map import GroundMap
from wayloom.ground.merge import merge_sheets
from wayloom.ground.placed_sheet import PlacedSheet, reach
from wayloom.ground.sheet import GROUND_CLASSES
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import open_truth
from wayloom.stitching.region_areas import areas_of
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges, regions_within
from wayloom.submaps.files import load_submaps

PAGE = DOCS / "benchmarks" / "areas.md"
ROAD, SIDEWALK, TERRAIN = GROUND_CLASSES


@dataclass(frozen=True)
class Regions:
    """The merged ground of regions, as `mosaic` reads it."""

    made: dict[RegionKey, GroundMap]

    def raster(self, key: RegionKey, name: str) -> NDArray[np.generic] | None:
        """A raster of a region, None where it has no ground."""
        return getattr(self.made[key], name) if key in self.made else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--write")
    options = parser.parse_args()
    pairs = list(zip(options.paths[::2], options.paths[1::2], strict=True))
    low, true = truth_of(pairs)
    rows = {"map of all": score(sheets_of(pairs), low, true)}
    rows |= {log.name: score(sheets_of([(out, log)]), *truth_of([(out, log)])) for out, log in pairs}
    text = table(rows)
    print(text)
    if options.write:
        put_between_marks(PAGE, options.write, text)


def truth_of(pairs: list[tuple[Path, Path]]) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Corner (2,) and class (H, W) of the cells that the truth images of all drives show near their tracks, NONE of others."""
    parts = [true_ground(open_truth(log), open_log(log).rig.camera) for _, log in pairs]
    low = np.min([one.corner for one in parts], axis=0)
    high = np.max([one.corner + one.height.shape[::-1] for one in parts], axis=0)
    out = np.full((high - low)[::-1], NONE, np.uint8)
    for one in parts:
        (c, r), (rows, columns) = one.corner - low, one.height.shape
        here = out[r : r + rows, c : c + columns]
        seen = (one.distance <= NEAR_TRACK_M) & (here == NONE)
        here[seen] = one.class_id[seen]
    return low, out


def sheets_of(pairs: list[tuple[Path, Path]]) -> list[PlacedSheet]:
    """The sheets of drives at their true places."""
    out = []
    for folder, log in pairs:
        stages, truth = folder / "stages", open_truth(log)
        index = read_index(stages / "ground")
        for item in load_submaps(stages / "submaps"):
            if item.submap.digest in index:
                digest = index[item.submap.digest]
                read = partial(load_sheet, stages / "ground", digest)
                out.append(PlacedSheet(log.name, digest, read, true_place(item.submap, truth.T_enu_cam), np.zeros((6, 6))))
    return out


def score(sheets: list[PlacedSheet], corner: NDArray[np.int64], true: NDArray[np.uint8]) -> AreaScores:
    """Scores of the map of sheets."""
    boxes = [reach(one.read(), one.T_map_submap) for one in sheets]
    keys = sorted({key for low, high in boxes for key in regions_within(low, high, 0.0)})
    made = {key: merge_sheets(sheets, region_edges(key)[0], REGION_M) for key in keys}
    source = Regions({key: one for key, one in made.items() if one is not None})
    areas = [area for key in source.made for area in areas_of(key, source, AreaSettings())]
    return score_areas(areas, true, corner, ROAD, (SIDEWALK, TERRAIN))


def table(rows: dict[str, AreaScores]) -> str:
    """Markdown, a row a map."""
    lines = [
        "| map | IoU road | IoU sidewalk | IoU terrain | truth covered | right class where covered | edge of the road,"
        " median, p95 | true edge found within 0.3 m |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, one in rows.items():
        iou = " | ".join(f"{one.iou.get(k, np.nan):.3f}" for k in (ROAD, SIDEWALK, TERRAIN))
        border = f"{100 * np.median(one.border_m):.1f} cm, {100 * np.percentile(one.border_m, 95):.0f} cm"
        lines.append(f"| {name} | {iou} | {one.covered:.3f} | {one.right:.3f} | {border} | {one.found:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
