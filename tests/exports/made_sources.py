"""Made maps as sources of exports, whole in memory, and drives on disk with ground."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ground.made_sheets import Street, cut
from objects.made_sightings import some_sightings
from tiles.made_maps import made_map, made_tracks
from wayloom.exports.provenance import provenance_of
from wayloom.geometry import se3
from wayloom.ground.files import save_sheets
from wayloom.objects.files import save_all
from wayloom.stitching.region_grid import REGION_M, RegionKey
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.files import save_submaps
from workers.test_ground_of_map import submap_at

POLES = np.array([[20.0, 25.0, 0.4], [40.0, 35.5, 0.9], [55.0, 25.0, 1.1]])
"""m in the map's frame."""


class MadeSource:
    """`exports.source.MapSource` of a voxel map in memory."""

    def __init__(self, whole: VoxelMap) -> None:
        self.whole, self.frame, self.voxel_m = whole, whole.frame, whole.voxel_m
        at = np.floor(whole.points_enu[:, :2] / REGION_M).astype(int)
        self.keys: list[RegionKey] = sorted({(east, north) for east, north in at.tolist()})
        self._rows = {key: np.flatnonzero((at == key).all(axis=1)) for key in self.keys}
        self.place = np.median(whole.points_enu, axis=0) if len(whole) else np.zeros(3)

    def voxels(self, key: RegionKey) -> VoxelMap | None:
        return self.whole.take(self._rows[key]) if key in self._rows else None

    def raster(self, key: RegionKey, name: str) -> None:
        return None

    def place_sigma_mm(self, key: RegionKey) -> Any:
        return np.zeros(0, np.uint16)

    def features(self, name: str, key: RegionKey) -> tuple[()]:
        return ()

    def tracks(self) -> Any:
        return iter(made_tracks(self.whole))

    def doubts(self) -> dict[str, Any]:
        return {}

    def provenance(self) -> dict[str, Any]:
        drive = {"id": "a", "sha256": {"manifest": "1" * 64}, "network": {"name": "made"}}
        return provenance_of("made", [drive], self.frame, {"merge": {"voxel_m": 0.1}}, "c0de")


def made_source(voxels: int = 3000, **where: Any) -> MadeSource:
    return MadeSource(made_map(voxels, **where))


def drives_with_ground(root: Path) -> list[Path]:
    """Folders of two drives, one after the other along one street, which both see its poles."""
    folders = []
    for number, start in enumerate((0.0, 30.0)):
        sheet = cut(Street(), start, start + 42.0, "ab"[number] * 64, seed=number, t_s=100 + 900 * number)
        item = submap_at(sheet, number)
        folders.append(root / f"drive{number}")
        save_submaps([item], folders[-1] / "stages" / "submaps")
        seen = some_sightings(se3.transform(se3.inverse(item.T_enu_submap), POLES), name=item.submap.digest)
        save_all([seen], folders[-1] / "stages" / "objects")
        save_sheets([replace(sheet.read(), submap=item.submap.digest)], folders[-1] / "stages" / "ground")
    return folders
