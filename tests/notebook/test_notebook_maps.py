"""The doors of the Python API: lazily imported, the same map from folders, a service and tiles, heights and frames."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import wayloom
from exports.made_sources import drives_with_ground
from service_kit.published_regions import publish_drives
from service_kit.running import ApiAlone
from wayloom.client.api import Api
from wayloom.client.map_sync import SyncChoice, sync_map
from wayloom.errors import InputError
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.geodesy import wgs84


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return drives_with_ground(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def service(folders: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    alone = ApiAlone(tmp_path_factory.mktemp("service"))
    publish_drives(alone.data, DriveOutputs(folders))
    yield alone
    alone.close()


@pytest.fixture(scope="module")
def own(folders: list[Path]) -> wayloom.Map:
    return wayloom.Map(*folders)


def test_importing_the_package_loads_no_library() -> None:
    code = "import sys, wayloom; print(sorted({'numpy', 'numba', 'cv2', 'gtsam', 'pydantic', 'wayloom.notebook'} & {*sys.modules}))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
    assert {"Map", "Drive", "open_log", "process"} <= {*dir(wayloom)}
    with pytest.raises(AttributeError, match="Map"):
        _ = wayloom.maps  # type: ignore[attr-defined]


def test_a_service_and_folders_give_the_same_map(own: wayloom.Map, service: ApiAlone) -> None:
    served = wayloom.Map(service.url)
    assert len(own.voxels) > 100
    assert np.array_equal(served.voxels.points, own.voxels.points)
    assert np.array_equal(served.voxels.label, own.voxels.label)
    assert served.features("markings") == own.features("markings") != []
    assert own.features("objects") != []
    with pytest.raises(InputError, match="use tracks"):
        _ = served.trajectories


def test_a_folder_of_tiles_gives_the_points_to_the_tiles_own_resolution(
    own: wayloom.Map, service: ApiAlone, tmp_path: Path
) -> None:
    with Api(service.url) as api:
        sync_map(api, tmp_path / "tiles", SyncChoice("city", layers=("points",)))
    tiles = wayloom.Map(tmp_path / "tiles")
    assert len(tiles.voxels) == len(own.voxels)
    assert np.array_equal(np.bincount(tiles.voxels.label), np.bincount(own.voxels.label))
    assert tiles.frame is not None
    places = wgs84.enu_from_lonlatheight(own.lonlatheight(own.voxels.points), tiles.frame)
    assert np.abs(np.sort(tiles.voxels.points, axis=0) - np.sort(places, axis=0)).max() < 0.02
    with pytest.raises(InputError, match="points alone"):
        tiles.features("areas")


def test_a_box_leaves_what_lies_in_it(own: wayloom.Map, folders: list[Path]) -> None:
    places = own.lonlatheight(own.voxels.points)
    west, south = places[:, :2].min(axis=0)
    east, north = np.median(places[:, :2], axis=0)
    part = wayloom.Map(*folders, bbox=(west, south, east, north))
    assert 0 < len(part.voxels) < len(own.voxels)
    with pytest.raises(InputError, match="no box"):
        wayloom.Map(*folders, bbox=(west, south, east))


def test_ground_heights_are_those_of_the_cells_and_nan_elsewhere(own: wayloom.Map) -> None:
    assert own.frame is not None
    key = next(key for key in own.source.keys if own.source.raster(key, "height_mm") is not None)
    heights = own.source.raster(key, "height_mm")
    assert heights is not None
    row, column = (int(found[len(found) // 2]) for found in np.nonzero(heights != -(2**31)))
    enu = np.array([[key[0] * 64 + 0.1 * column + 0.05, key[1] * 64 + 0.1 * row + 0.05, heights[row, column] / 1000.0]])
    place = wgs84.lonlatheight_from_enu(enu, own.frame)
    found = own.ground_height(np.vstack([place[:, :2], place[:, :2] + 0.5]))
    assert abs(found[0] - place[0, 2]) < 0.001
    assert np.isnan(found[1])


def test_geodataframes_have_a_row_a_feature_and_the_columns_of_their_collection(own: wayloom.Map) -> None:
    objects, kerbs = own.geo("objects"), own.geo("kerbs")
    assert len(objects) == len(own.features("objects"))
    assert {"kind", "confidence", "height_m"} <= {*objects.columns}
    assert objects.crs.to_epsg() == 4979
    west, south, east, north = objects.total_bounds
    assert 8.0 < west < east < 9.0
    assert 48.0 < south < north < 50.0
    assert {"kind", "height_m"} <= {*kerbs.columns}
    voxels = own.geo("voxels")
    assert (len(voxels), voxels.geometry.has_z.all()) == (len(own.voxels), True)
    assert {*voxels["class"]} <= {"road", "sidewalk", "building", "vegetation", "pole", "terrain", "fence", "wall", "traffic sign"}


@pytest.mark.parametrize("name", ["voxel", "pole"])
def test_an_unknown_collection_lists_the_known_ones(own: wayloom.Map, name: str) -> None:
    with pytest.raises(InputError, match="areas, objects"):
        own.geo(name)


def test_folders_that_are_none_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wayloom process"):
        wayloom.Drive(tmp_path)
    with pytest.raises(InputError, match="wayloom process"):
        wayloom.Map(tmp_path)
    with pytest.raises(InputError, match="do not mix"):
        wayloom.Map(tmp_path, "http://127.0.0.1:1")
