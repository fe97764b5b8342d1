"""Outputs of `wayloom process` of some drives as one map, fused region by region when it is asked for.

The drives are taken where their own geo-reference places them: no meetings are sought, nothing is aligned. Drives of several degree
cells are moved into one frame, which depends on the set of them alone.
"""

import json
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ConfigError, InputError
from wayloom.exports.drive_origin import REPORT_FILE, drive_origin
from wayloom.exports.provenance import provenance_of
from wayloom.exports.source import Feature
from wayloom.geodesy.antimeridian import Box, overlap
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.ground_map import GroundFile
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.merge import HALO_M, merge_sheets
from wayloom.ground.placed_sheet import PlacedSheet, reach
from wayloom.objects.exports import placed_sightings
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import PlacedSightings
from wayloom.stitching.ground_mosaic import GroundOfRegions
from wayloom.stitching.layer_names import LAYERS, STATIC
from wayloom.stitching.marking_files import read_features
from wayloom.stitching.region_areas import region_areas
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_box, region_edges, regions_within
from wayloom.stitching.region_markings import region_markings
from wayloom.stitching.region_objects import region_objects
from wayloom.stitching.regions import fuse_region, regions_of
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.files import SubmapEntry, submap_entries
from wayloom.submaps.frames import common_frame, in_frame
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.feature_layers import OBJECTS
from wayloom.tiles.pyramid import Track, tracks_of

FloatArray = NDArray[np.float64]
SUBMAP_FOLDERS: Final = (".", "submaps", "stages/submaps")
ON_GROUND: Final[Mapping[str, Callable[[RegionKey, GroundOfRegions, MapFrame], bytes | None]]] = {
    "markings": lambda key, ground, frame: region_markings(key, ground, frame, MarkingSettings(), KerbSettings()),
    "areas": lambda key, ground, frame: region_areas(key, ground, frame, AreaSettings()),
}
"""Features that are found on the ground of a region and of those around it."""
HELD_SUBMAPS, HELD_SHEETS, HELD_REGIONS, HELD_RASTERS = 32, 24, 9, 48


def submap_folder(folder: Path) -> Path:
    """The folder with `index.json` in or under a folder. Raises InputError when there is none."""
    for name in SUBMAP_FOLDERS:
        if (folder / name / "index.json").is_file():
            return folder / name
    if str(folder).startswith(("http:", "https:")):
        raise ConfigError(
            "a server's map is named by --from URL", record=str(folder), remedy="wayloom export --from URL --out FILE"
        )
    raise InputError("holds no submaps", file=folder, remedy="give the folder that `wayloom process` wrote")


class DriveOutputs:
    """`source.MapSource` of folders that `wayloom process` wrote, or of folders of submaps.

    Raises InputError for a folder without submaps, and for a drive without a place on Earth beside others.
    """

    def __init__(
        self, folders: Sequence[Path], settings: MergeSettings = MergeSettings(), box: Box | None = None, code: str = ""
    ) -> None:
        self._settings, self._code, self._folders = settings, code, [*map(submap_folder, folders)]
        self.voxel_m = settings.voxel_m
        found = {(one.drive_id, one.digest): one for folder in self._folders for one in submap_entries(folder)}
        self._entries = [found[name] for name in sorted(found)]
        self.frame = _frame(self._entries)
        if self.frame is None and box is not None:
            raise InputError("has no place on Earth to cut a box from", file=folders[0], remedy="leave --bbox away")
        self._load = lru_cache(HELD_SUBMAPS)(self._loaded)
        self._box = box
        self._rows: dict[RegionKey, list[int]] = {}
        for row in range(len(self._entries)):
            for key in sorted(regions_of(self._load(row), settings)):
                self._rows.setdefault(key, []).append(row)
        self._voxels = lru_cache(HELD_REGIONS)(self._fused)
        self._sightings = lru_cache(HELD_SUBMAPS)(self._loaded_sightings)
        self._of_region = cache(self._found)  # some kilobytes a region, seconds to find

    def _loaded(self, row: int) -> PlacedSubmap:
        item = self._entries[row].load()
        return item if self.frame is None else in_frame(item, self.frame)

    def _is_wanted(self, key: RegionKey) -> bool:
        return self._box is None or self.frame is None or overlap(region_box(key, self.frame, 0.0), self._box)

    @cached_property
    def keys(self) -> Sequence[RegionKey]:
        """The regions that points or ground may lie in."""
        return sorted(key for key in {*self._rows, *self._ground.keys} if self._is_wanted(key))

    @cached_property
    def place(self) -> FloatArray:
        """The camera's place in the middle of the submaps."""
        origins = np.array([self._load(row).T_enu_submap[:3, 3] for row in range(len(self._entries))])
        return np.asarray(np.median(origins.reshape(-1, 3), axis=0)) if len(origins) else np.zeros(3)

    def voxels(self, key: RegionKey) -> VoxelMap | None:
        """The static layer of a region."""
        return self._voxels(key) if key in self._rows else None

    def _fused(self, key: RegionKey) -> VoxelMap:
        return fuse_region(key, [self._load(row) for row in self._rows[key]], self._settings).layers[LAYERS[STATIC]]

    def tracks(self) -> Iterator[Track]:
        """The drives' tracks, one drive in memory at a time."""
        for drive_id in sorted({entry.drive_id for entry in self._entries}):
            yield from tracks_of(self._load(row) for row, entry in enumerate(self._entries) if entry.drive_id == drive_id)

    def stages(self) -> dict[str, Path]:
        """The folder of the stages of each drive, by the drive's id, sorted; of drives whose folders are whole."""
        found = {entry.drive_id: entry.folder.parent for entry in self._entries}
        return {name: found[name] for name in sorted(found) if (found[name] / "georeference").is_dir()}

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of a region's merged ground; None where it has none."""
        return self._ground.raster(key, name)

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """Of the sheets of a region's ground."""
        return self._ground.place_sigma_mm(key)

    def features(self, name: str, key: RegionKey) -> Sequence[Feature]:
        """The features of a collection that belong to a region."""
        data = self._of_region(name, key)
        return () if data is None else read_features(data, str(key))

    def _found(self, name: str, key: RegionKey) -> bytes | None:
        if name == OBJECTS:
            return self._found_objects(key)
        if self.frame is None or name not in ON_GROUND or not self._ground.has(key):
            return None
        return ON_GROUND[name](key, self, self.frame)

    def _found_objects(self, key: RegionKey) -> bytes | None:
        """Of what the drives saw along the submaps that bear on a region."""
        if self.frame is None:
            return None
        seen = [one for row in self._rows.get(key, ()) if (one := self._sightings(row)) is not None]
        return region_objects(key, seen, self.frame, ObjectFusionSettings())

    def _loaded_sightings(self, row: int) -> PlacedSightings | None:
        """Those of a submap; None of a drive without."""
        folder = self._entries[row].folder.parent / "objects"
        found = placed_sightings(folder, [self._load(row)]) if (folder / "index.json").is_file() else []
        return found[0] if found else None

    @cached_property
    def _ground(self) -> "MergedSheets":
        sheets = self._sheets() if self.frame is not None else []
        return MergedSheets(sheets)

    def _sheets(self) -> list[PlacedSheet]:
        """The ground sheets beside the folders of submaps, where these lie."""
        load, found = lru_cache(HELD_SHEETS)(load_sheet), []
        folders = [folder.parent / "ground" for folder in self._folders]
        indices = {folder: read_index(folder) for folder in dict.fromkeys(folders) if (folder / "index.json").is_file()}
        for row, entry in enumerate(self._entries):
            folder = entry.folder.parent / "ground"
            digest = indices.get(folder, {}).get(entry.digest)
            if digest is not None:
                item = self._load(row)
                read = partial(load, folder, digest)
                found.append(PlacedSheet(item.drive_id, digest, read, item.T_enu_submap, item.covariance))
        return found

    def doubts(self) -> Mapping[str, Sequence[str]]:
        """The warnings of the drives' reports, where the folders have them."""
        found: dict[str, Sequence[str]] = {}
        for entry in self._entries:
            report = entry.folder.parent.parent / REPORT_FILE
            if entry.drive_id not in found and report.is_file():
                found[entry.drive_id] = json.loads(report.read_bytes()).get("warnings", ())
        return {drive_id: warnings for drive_id, warnings in found.items() if warnings}

    def provenance(self) -> Mapping[str, Any]:
        """Drives with the hashes of what they were made from."""
        names: dict[Path, set[str]] = {}
        for entry in self._entries:
            names.setdefault(entry.folder, set()).add(entry.drive_id)
        drives = [drive_origin(folder.parent, name) for folder in sorted(names) for name in sorted(names[folder])]
        parameters = json.loads(self._settings.model_dump_json())
        return provenance_of("outputs of wayloom process", drives, self.frame, {"merge": parameters}, self._code)


class MergedSheets:
    """The merged ground of sheets, made region by region when it is asked for, and kept on disk.

    keys : of the regions that may have ground, sorted
    """

    def __init__(self, placed: Sequence[PlacedSheet]) -> None:
        touched: set[RegionKey] = set()
        self._near: dict[RegionKey, list[PlacedSheet]] = {}
        for one in placed:
            box = reach(one.read(), one.T_map_submap)
            touched.update(regions_within(*box, around_m=0.0))
            for key in regions_within(*box, around_m=HALO_M):
                self._near.setdefault(key, []).append(one)
        self.keys: Sequence[RegionKey] = sorted(touched)
        self._touched = touched
        self._folder = Path(tempfile.mkdtemp(prefix="wayloom-export-"))
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._raster = lru_cache(HELD_RASTERS)(self._unpacked)

    def has(self, key: RegionKey) -> bool:
        """Whether a region may have ground."""
        return key in self._touched

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of a region's ground."""
        return self._raster(key, name) if key in self._touched else None

    def _unpacked(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        file = self._file(key)
        return None if file is None else file.raster(name)

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """Of the sheets of a region's ground."""
        file = self._file(key)
        return np.zeros(0, np.uint16) if file is None else file.place_sigma_mm

    def _file(self, key: RegionKey) -> GroundFile | None:
        path = self._folder / f"{key[0]}_{key[1]}.ground"
        if not path.exists():
            ground = merge_sheets(self._near[key], region_edges(key)[0], REGION_M)
            path.write_bytes(b"" if ground is None else ground.encoded())
        data = path.read_bytes()
        return GroundFile(data, str(key)) if data else None


def _frame(entries: Sequence[SubmapEntry]) -> MapFrame | None:
    """The frame that all submaps are moved into. Raises InputError where drives without a place on Earth lie beside others."""
    placed = [entry.frame for entry in entries if entry.frame is not None]
    loose = [entry for entry in entries if entry.frame is None]
    if loose and (placed or len({entry.drive_id for entry in loose}) > 1):
        raise InputError(
            f"drive {loose[0].drive_id} has no place on Earth, so none beside other drives",
            file=loose[0].folder,
            remedy="export it alone, or process it with --gnss",
        )
    return common_frame(placed) if placed else None
