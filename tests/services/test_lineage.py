"""Lineage over HTTP: a tile and a point of a version say which drives, runs and regions they were made from."""

from dataclasses import dataclass

import httpx2
import numpy as np
import pytest

from service_kit.running import ApiAlone
from tiles.made_maps import made_map
from wayloom.geodesy import wgs84
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.region_files import encode_region
from wayloom.stitching.region_grid import REGION_M, RegionMap
from wayloom.store import drives, map_versions, maps, runs
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion, RegionEntry
from wayloom.tiles.grid import pixel_from_lonlat

STAGES = {
    "submaps": {
        "key": "4" * 64,
        "digest": "5" * 64,
        "code": "6" * 64,
        "libraries": {"numpy": "2.4"},
        "parameters": {"submaps": {}},
    },
    "segmentation": {"key": "1" * 64, "parameters": {"description": {"name": "city"}, "sha256": "2" * 64, "device": "cpu"}},
}
CITY = made_map(voxels=400, extent_m=60.0)


@dataclass(frozen=True)
class Known:
    """A region of two versions of the map `other`: made from one submap of a drive, then from another."""

    drive_id: str
    digest: str
    lon: float
    lat: float
    voxel: int


@pytest.fixture(scope="module")
def known(api_process: ApiAlone) -> Known:
    assert CITY.frame is not None
    squares = np.floor(CITY.points_enu[:, :2] / REGION_M).astype(int)
    east, north = squares[0].tolist()
    rows = np.flatnonzero((squares == squares[0]).all(axis=1))
    empty = CITY.take(np.zeros(0, np.int64))
    region = RegionMap((east, north), {name: CITY.take(rows) if name == "static" else empty for name in LAYERS})
    digest = BlobStore(api_process.data / "blobs").put(encode_region(region, CITY.frame))
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        manifest = Manifest(name="north street", vehicle_id="bus 1", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive = drives.register(session, manifest, "other")[0]
        for base, submap in enumerate(("a" * 64, "b" * 64)):
            runs.record(session, drive, {**STAGES, "odometry": {"key": str(base) * 64}}, [submap])
            entry = RegionEntry(east, north, "7" * 64, digest, [[drive.id, submap]], 100)
            frame = (CITY.frame.lon_deg, CITY.frame.lat_deg, CITY.frame.height_m)
            new = NewVersion(base, frame, (drive.id,), 1, None, (), regions=[entry], built_with="8" * 64)
            map_versions.publish(session, "other", new, kept=9)
        drive_id = drive.id
        maps.ensure_map(session, "city")
    database.close()
    lon, lat, _ = wgs84.lonlatheight_from_enu(CITY.points_enu[rows[:1]], CITY.frame)[0].tolist()
    return Known(drive_id, digest, lon, lat, int(rows[0]))


def lineage(http: httpx2.Client, version: int, **asked: object) -> httpx2.Response:
    return http.get(f"/v1/maps/other/versions/{version}/lineage", params=asked)  # type: ignore[arg-type]


def test_a_tile_says_of_which_drives_submaps_and_runs_it_was_made_in_each_version(http: httpx2.Client, known: Known) -> None:
    x, y = (pixel_from_lonlat(np.array([[known.lon, known.lat]]), 18)[0] // 256).tolist()
    for version, submap in ((1, "a" * 64), (2, "b" * 64)):
        said = lineage(http, version, tile=f"18/{x}/{y}").json()
        assert [region["digest"] for region in said["regions"]] == [known.digest]
        assert (said["version"], said["built_with"], said["voxels"]) == (version, "8" * 64, None)
        (drive,) = said["drives"]
        assert (drive["id"], drive["name"], drive["vehicle_id"]) == (known.drive_id, "north street", "bus 1")
        assert drive["submaps"] == [submap]
        assert drive["run"]["number"] == version
        assert drive["run"]["network"] == {"name": "city", "sha256": "2" * 64, "device": "cpu"}
        made = {stage["stage"]: stage for stage in drive["run"]["stages"]}
        assert list(made) == ["odometry", "segmentation", "submaps"]
        assert made["odometry"]["key"] == str(version - 1) * 64
        assert (made["submaps"]["code"], made["submaps"]["libraries"]) == ("6" * 64, {"numpy": "2.4"})
        assert len(made["submaps"]["parameters"]) == 64


def test_a_point_names_the_voxels_around_it_with_their_drives_and_when_they_saw_them(http: httpx2.Client, known: Known) -> None:
    said = lineage(http, 2, lon=known.lon, lat=known.lat, radius_m=10).json()
    nearest = said["voxels"][0]
    assert nearest["distance_m"] < 0.01
    own = CITY.drive[CITY.drive_start[known.voxel] : CITY.drive_start[known.voxel + 1]]
    assert nearest["drives"] == [CITY.drive_ids[drive] for drive in own]
    assert nearest["first_seen"] == pytest.approx(CITY.first_seen_ns[known.voxel] / 1e9)
    assert nearest["last_seen"] == pytest.approx(CITY.last_seen_ns[known.voxel] / 1e9)
    distances = [voxel["distance_m"] for voxel in said["voxels"]]
    assert distances == sorted(distances)
    assert max(distances) <= 10
    assert [drive["id"] for drive in said["drives"]] == [known.drive_id]


def test_where_nothing_is_mapped_nothing_was_used(http: httpx2.Client, known: Known) -> None:
    assert known.digest
    said = lineage(http, 2, lon=9.5, lat=49.9).json()
    assert (said["regions"], said["drives"], said["voxels"]) == ([], [], [])


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize(
    ("asked", "status"),
    [
        ({}, 400), ({"lon": 8.4}, 400), ({"tile": "18/1/1", "lon": 8.4, "lat": 49.0}, 400), ({"tile": "13/1/1"}, 400),
        ({"tile": "18/999999/1"}, 400), ({"tile": "18/1"}, 422), ({"lon": 8.4, "lat": 89.0}, 422),
    ],
)  # fmt: skip
def test_what_is_no_place_is_refused(http: httpx2.Client, asked: dict[str, object], status: int) -> None:
    assert lineage(http, 1, **asked).status_code == status


def test_the_runs_of_a_drive_give_the_settings_by_value(http: httpx2.Client, known: Known) -> None:
    found = http.get(f"/v1/drives/{known.drive_id}/runs").json()["runs"]
    assert [run["number"] for run in found] == [2, 1]
    assert found[0]["parameters"]["segmentation"] == STAGES["segmentation"]["parameters"]
    assert found[0]["submaps"] == ["b" * 64]
    assert http.get(f"/v1/drives/{'f' * 64}/runs").status_code == 404


def test_a_withdrawn_version_says_that_it_is_gone_and_why(http: httpx2.Client, api_process: ApiAlone) -> None:
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        manifest = Manifest(name="to be removed", files=(ManifestFile(path="log/a", size=1, sha256="1" * 64),))
        drive_id = drives.register(session, manifest, "third")[0].id
        map_versions.publish(session, "third", NewVersion(0, (8.5, 48.5, 0.0), (drive_id,), 1, None, ()), kept=9)
        drives.delete_rows(session, drive_id)
        map_versions.publish(session, "third", NewVersion(1, (8.5, 48.5, 0.0), (), 0, None, ()), kept=9)
    database.close()
    for path in ("", "/tiles/semantic/18/1/1.png", "/changes", "/lineage?tile=18/1/1"):
        answer = http.get(f"/v1/maps/third/versions/1{path}")
        assert (answer.status_code, answer.json()["code"]) == (410, "withdrawn")
        assert "/v1/maps/third" in answer.json()["detail"]
    assert [version["version"] for version in http.get("/v1/maps/third/versions").json()["versions"]] == [2]
