"""OGC API Features of a map: documents, pages, boxes, times, kinds, refusals, and GDAL's own reader."""

import json
import os
import subprocess
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import httpx2
import numpy as np
import pytest

from service_kit.programs import needed
from services.conftest import ApiAlone
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.marking_files import encode_features
from wayloom.store import drives, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion, RegionEntry, publish
from wayloom.store.tables.drives import Drive

FRAME = MapFrame(8.4, 49.0, 100.0)
HOME = "/v1/maps/town/ogc"
DAY_NS = 86_400 * 10**9
FIRST_NS = int(datetime.fromisoformat("2026-06-01T00:00:00Z").timestamp()) * 10**9


def lonlat(*places: tuple[float, float]) -> list[list[float]]:
    """Of m east and north."""
    points = np.array([[x, y, 0.0] for x, y in places])
    found: list[list[float]] = np.round(wgs84.lonlatheight_from_enu(points, FRAME), 9).tolist()
    return found


def feature(kind: str, geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": {"kind": kind, **properties},
    }


def thing(number: int, kind: str, x: float, y: float, day: int) -> dict[str, Any]:
    name = f"{int(x // 64)}.{int(y // 64)}.{kind}-{number}"
    told = {
        "id": name,
        "height_m": 2.5,
        "drives": ["a" * 64],
        "first_ns": FIRST_NS + day * DAY_NS,
        "last_ns": FIRST_NS + (day + 1) * DAY_NS,
    }
    return {**feature(kind, "Point", lonlat((x, y))[0], **told), "id": name}


POLES = [thing(k, "pole", 3.0 + 10.0 * k, 5.0, k) for k in range(6)]
SIGN = thing(9, "traffic_sign", 70.0, 5.0, 9)
ROAD = feature("road", "Polygon", [lonlat((0, 0), (64, 0), (64, 8), (0, 8), (0, 0))], area_m2=512.0)
DASH, KERB = feature("dash", "LineString", lonlat((1, 4), (4, 4))), feature("kerb", "LineString", lonlat((1, 8), (60, 8)))
GONE = feature("gone", "Point", lonlat((30, 3))[0], noticed="2026-06-05T12:00:00.000Z")


@pytest.fixture(scope="module", autouse=True)
def _town(api_process: ApiAlone) -> Iterator[None]:
    """The first version has poles; the second a sign too, and holds a drive."""
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    blobs = BlobStore(Folders(api_process.data).blobs)
    objects, sign, areas, lines = (blobs.put(encode_features(one)) for one in (POLES, [SIGN], [ROAD], [DASH, KERB]))
    files = {"areas": areas, "markings": lines, "objects": objects}
    west = RegionEntry(0, 0, "1" * 64, "1" * 64, [], 10, [GONE], **files)
    east = RegionEntry(1, 0, "2" * 64, "2" * 64, [], 10, objects=sign)
    bounds = (*lonlat((0, 0))[0][:2], *lonlat((128, 64))[0][:2])
    with database.write() as session:
        manifest = Manifest(name="a drive", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive = session.get_one(Drive, drives.register(session, manifest, "town")[0].id)
        drive.track = [place[:2] for place in lonlat((0, 4), (100, 4))]
        for base, (regions, held) in enumerate((([west], ()), ([east], (drive.id,)))):
            frame = (FRAME.lon_deg, FRAME.lat_deg, FRAME.height_m)
            publish(session, "town", NewVersion(base, frame, held, 0, bounds, [], regions=regions), kept=5)
        maps.ensure_map(session, "bare")
    yield
    database.close()


def asked(http: httpx2.Client, path: str, status: int = 200, **query: str) -> dict[str, Any]:
    answer = http.get(path, params=query or None)
    assert answer.status_code == status, answer.text
    found: dict[str, Any] = answer.json()
    if status != 200:
        assert answer.headers["content-type"] == "application/problem+json"
    return found


def items(http: httpx2.Client, name: str, **query: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = asked(http, f"{HOME}/collections/{name}/items", **query)["features"]
    return found


def link(document: dict[str, Any], rel: str) -> str | None:
    return next((one["href"] for one in document["links"] if one["rel"] == rel), None)


@pytest.mark.parametrize("home", [HOME, "/v1/maps/town/versions/1/ogc"])
def test_every_document_is_reached_from_the_landing_page(http: httpx2.Client, home: str) -> None:
    page = asked(http, home)
    assert http.get(str(link(page, "service-desc"))).json()["paths"]["/v1/maps/{map_id}/ogc/collections/{name}/items"]
    said = asked(http, str(link(page, "conformance")))["conformsTo"]
    assert {one.rsplit("/", 1)[1] for one in said} == {"core", "geojson"}
    found = asked(http, str(link(page, "data")))["collections"]
    assert [one["id"] for one in found] == ["objects", "areas", "markings", "kerbs", "tracks", "changes"]
    for one in found:
        assert asked(http, str(link(one, "self"))) == one
        answer = http.get(str(link(one, "items")))
        assert answer.headers["content-type"] == "application/geo+json"
        for each in answer.json()["features"]:
            alone = asked(http, f"{link(one, 'items')}/{each['id']}")
            assert {name: alone[name] for name in each} == each


def test_collections_have_what_the_version_has(http: httpx2.Client) -> None:
    assert items(http, "objects") == [*POLES, SIGN]
    for name, one in (("areas", ROAD), ("markings", DASH), ("kerbs", KERB), ("changes", GONE)):
        (found,) = items(http, name)
        assert {key: found[key] for key in one} == one
    (track,) = items(http, "tracks")
    assert track["properties"]["name"] == "a drive"
    assert asked(http, "/v1/maps/town/versions/1/ogc/collections/objects/items")["features"] == POLES
    assert asked(http, "/v1/maps/town/versions/1/ogc/collections/tracks/items")["features"] == []


@pytest.mark.parametrize("limit", [1, 3, 6, 7, 100])
def test_links_of_next_pages_lead_through_each_feature_once(http: httpx2.Client, limit: int) -> None:
    found, address = [], f"{HOME}/collections/objects/items?limit={limit}&kind=pole,traffic_sign"
    for _ in range(9):
        page = asked(http, address)
        assert page["numberReturned"] == len(page["features"]) <= limit
        found += page["features"]
        following = link(page, "next")
        if following is None:
            break
        address = following
    assert found == [*POLES, SIGN]


def test_box_time_and_kind_choose(http: httpx2.Client) -> None:
    (west, south, _), (east, north, _) = lonlat((10, 0), (40, 10))
    assert items(http, "objects", bbox=f"{west},{south},{east},{north}") == POLES[1:4]
    assert items(http, "objects", bbox=f"{west},{south},-9,{east},{north},9") == POLES[1:4]
    assert items(http, "objects", kind="traffic_sign") == [SIGN]
    assert items(http, "objects", datetime="2026-06-03T06:00:00Z") == [POLES[2]]
    assert items(http, "objects", datetime="2026-06-05T12:00:00Z/..") == [*POLES[4:], SIGN]
    assert items(http, "objects", datetime="../2026-06-01T12:00:00+00:00") == POLES[:1]
    assert len(items(http, "areas", datetime="1999-01-01T00:00:00Z")) == 1
    assert len(items(http, "changes", datetime="2026-06-05T00:00:00Z/2026-06-06T00:00:00Z")) == 1
    assert items(http, "changes", datetime="2026-06-06T00:00:00Z/..") == []


@pytest.mark.parametrize(
    "query",
    [
        {"limit": "0"}, {"limit": "many"}, {"bbox": "1,2,3"}, {"bbox": "0,9,1,8"}, {"datetime": "yesterday"},
        {"datetime": "2026-06-01T00:00:00"}, {"datetime": "2026-06-02T00:00:00Z/2026-06-01T00:00:00Z"}, {"after": "1"},
        {"colour": "red"}, {"datetime": "/"},
    ],
)  # fmt: skip
def test_a_parameter_that_is_none_is_refused_with_400(http: httpx2.Client, query: dict[str, str]) -> None:
    assert asked(http, f"{HOME}/collections/objects/items", 400, **query)["code"] == "bad-request"


def test_more_than_the_most_is_cut_off_and_not_refused(http: httpx2.Client) -> None:
    assert items(http, "objects", limit="1000000") == [*POLES, SIGN]


def test_what_is_not_there_is_404(http: httpx2.Client) -> None:
    for path in (
        "/collections/houses",
        "/collections/houses/items",
        "/collections/objects/items/0.0.no",
        "/collections/kerbs/items/0.0.0",
    ):
        assert asked(http, HOME + path, 404)["code"] == "not-found"
    for home in ("/v1/maps/nowhere/ogc", "/v1/maps/bare/ogc", "/v1/maps/town/versions/9/ogc"):
        asked(http, home, 404)
    asked(http, f"{HOME}/conformance", 400, colour="red")


def test_the_definition_tells_every_answer_of_every_endpoint(http: httpx2.Client) -> None:
    paths = asked(http, "/v1/openapi.json")["paths"]
    own = {path: one["get"] for path, one in paths.items() if "/ogc" in path}
    assert len(own) == 12
    for path, one in own.items():
        assert {"200", "400", "401", "404", "410"} <= one["responses"].keys(), path
    parameters = {one["name"] for one in own["/v1/maps/{map_id}/ogc/collections/{name}/items"]["parameters"]}
    assert parameters == {"map_id", "name", "bbox", "datetime", "limit", "after", "kind"}


def test_gdal_reads_every_collection(api_process: ApiAlone) -> None:
    needed("ogrinfo", "gdal-bin")
    source = f"OAPIF:{api_process.url.rstrip('/')}{HOME}"
    for name, count, geometry in (
        ("objects", 7, "POINT"),
        ("areas", 1, "POLYGON"),
        ("kerbs", 1, "LINESTRING"),
        ("tracks", 1, "LINESTRING"),
    ):
        command = ["ogrinfo", "-ro", "-al", "-oo", "PAGE_SIZE=3", source, name]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ, "no_proxy": "*"}, check=True)
        assert done.stdout.count("OGRFeature(") == count, done.stdout
        assert f"  {geometry}" in done.stdout
        assert done.stderr == ""
    chosen = ["ogr2ogr", "-f", "GeoJSON", "/vsistdout/", source, "objects", "-where", "kind = 'traffic_sign'"]
    (sign,) = json.loads(subprocess.run(chosen, capture_output=True, text=True, timeout=120, check=True).stdout)["features"]
    assert sign["geometry"]["coordinates"][:2] == pytest.approx(SIGN["geometry"]["coordinates"][:2], abs=1e-6)
