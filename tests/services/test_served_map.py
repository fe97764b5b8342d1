"""A published version that is exported from its server: the same files as from the regions on disk."""

import json
from collections.abc import Iterator

import httpx2
import laspy
import numpy as np
import pytest

from exports.made_sources import drives_with_ground
from service_kit.published_regions import region_entry
from services.conftest import ApiAlone
from wayloom.client.api import Api
from wayloom.client.served_map import ServedMap
from wayloom.errors import ServiceError
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.formats import Export, export_map
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.stitching.region_grid import region_edges
from wayloom.store import drives as drive_rows
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion, publish
from wayloom.store.tables.maps import MapDrive

MAP = "exported"


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> DriveOutputs:
    return DriveOutputs(drives_with_ground(tmp_path_factory.mktemp("street")))


@pytest.fixture(scope="module", autouse=True)
def _version(api_process: ApiAlone, drives: DriveOutputs) -> Iterator[None]:
    """Two versions: one of all regions, then one of the first alone."""
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    blobs = BlobStore(Folders(api_process.data).blobs)
    frame = drives.frame
    assert frame is not None

    entries = [region_entry(drives, key, blobs) for key in drives.keys]
    with database.write() as session:
        maps.ensure_map(session, MAP)
        origin = (frame.lon_deg, frame.lat_deg, frame.height_m)
        publish(session, MAP, NewVersion(0, origin, ("a" * 64,), 0, None, [], regions=entries), kept=5)
        dropped = [entry.key for entry in entries[1:]]
        publish(session, MAP, NewVersion(1, origin, ("a" * 64,), 0, None, [], dropped_regions=dropped), kept=5)
    yield
    database.close()


@pytest.fixture
def api(api_process: ApiAlone) -> Iterator[Api]:
    with Api(api_process.url) as found:
        yield found


def test_a_served_version_gives_the_points_ground_and_features_of_its_regions(api: Api, drives: DriveOutputs) -> None:
    served = ServedMap(api, MAP, 1)
    assert (served.frame, [*served.keys], served.voxel_m) == (drives.frame, [*drives.keys], drives.voxel_m)
    for key in drives.keys:
        own, there = drives.voxels(key), served.voxels(key)
        assert there is not None
        assert np.array_equal(there.points_enu, np.zeros((0, 3)) if own is None else own.points_enu)
        for name in ("height_mm", "colour"):
            one, other = drives.raster(key, name), served.raster(key, name)
            assert (one is None) == (other is None)
            assert one is None or np.array_equal(one, other)
        assert [*served.features("markings", key)] == [*drives.features("markings", key)]


def test_the_newest_version_is_exported_unless_another_is_asked_for(api: Api, drives: DriveOutputs) -> None:
    assert [*ServedMap(api, MAP).keys] == [*drives.keys][:1]


def test_files_from_a_server_are_those_of_the_regions(api: Api, drives: DriveOutputs, tmp_path: object) -> None:
    from pathlib import Path

    assert isinstance(tmp_path, Path)
    for source, name in ((ServedMap(api, MAP, 1), "served"), (drives, "own")):
        for suffix in ("laz", "geojson"):
            export_map(Export(source, tmp_path / f"{name}.{suffix}", layers=("markings", "kerbs") if suffix == "geojson" else ()))
    served, own = (laspy.read(tmp_path / f"{name}.laz") for name in ("served", "own"))
    for dimension in ("intensity", "gps_time", "label", "confidence"):
        assert np.array_equal(served[dimension], own[dimension])
    assert np.abs(np.array(served.xyz) - np.array(own.xyz)).max() < 0.0011  # the two have other offsets
    features = [json.loads((tmp_path / f"{name}.geojson").read_text())["features"] for name in ("served", "own")]
    assert features[0] == features[1]


def test_a_box_asks_for_the_regions_that_it_touches(api: Api, drives: DriveOutputs) -> None:
    assert drives.frame is not None
    key = drives.keys[0]
    low, high = region_edges(key)
    middle = np.array([[*(0.5 * (low + high)), 0.0]]) + np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])[:, None][:, 0]
    box = box_of(wgs84.lonlatheight_from_enu(middle, drives.frame)[:, :2])
    assert [*ServedMap(api, MAP, 1, box).keys] == [key]


def test_the_provenance_names_drives_by_the_hash_of_their_upload(api: Api) -> None:
    served = ServedMap(api, MAP, 1)
    told = served.provenance()
    assert told["origin"] == api.url
    assert [drive["sha256"] for drive in told["drives"]] == [{"manifest": "a" * 64}]
    assert told["parameters"]["version"] == 1


def test_a_part_has_the_etag_of_its_content_and_none_is_404(http: httpx2.Client, api: Api, drives: DriveOutputs) -> None:
    listed = http.get(f"/v1/maps/{MAP}/versions/1/regions").json()["regions"]
    painted = next(one for one in listed if one["markings"])
    address = f"/v1/maps/{MAP}/versions/1/regions/{painted['east']}/{painted['north']}"
    answer = http.get(f"{address}/markings")
    assert answer.headers["etag"] == f'"{painted["markings"]}"'
    assert "immutable" in answer.headers["cache-control"]
    assert http.get(f"{address}/tiles").status_code == 422
    for elsewhere in (f"/v1/maps/{MAP}/versions/1/regions/9/9/voxels", f"/v1/maps/{MAP}/versions/9/regions/0/0/voxels"):
        assert http.get(elsewhere).status_code == 404


def test_an_unknown_map_and_a_server_that_is_not_there_are_told(api: Api) -> None:
    with pytest.raises(ServiceError, match="404"):
        ServedMap(api, "nowhere")


def test_a_served_version_tells_what_its_drives_warn_of(api: Api, api_process: ApiAlone) -> None:
    assert ServedMap(api, MAP, 1).doubts() == {}
    manifest = Manifest(name="doubted street", vehicle_id="bus 1", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    scale = {"mean": 1.031, "sigma": 0.001}
    with database.write() as session:
        drive = drive_rows.register(session, manifest, MAP)[0]
        drive.state, drive.facts, drive_id = "done", {"georeference": {"scale": scale, "messages": []}}, drive.id
        session.add(MapDrive(map_id=MAP, drive_id=drive_id, since=1))
    database.close()
    ((told, words),) = ServedMap(api, MAP, 1).doubts().items()
    assert told == drive_id
    assert any("3.1 %" in one for one in words)
