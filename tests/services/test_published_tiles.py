"""Tiles of a published map over HTTP: bytes, hashes, versions, and how layers are described to viewers."""

import re

import httpx2
import pytest

from service_kit.running import ApiAlone
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, TileEntry, publish


@pytest.fixture(scope="module")
def published(api_process: ApiAlone) -> TileEntry:
    """A tile of a published version, its bytes in the blob store."""
    digest = BlobStore(api_process.data / "blobs").put(b"not really a picture")
    tile = TileEntry("semantic", 18, 137188, 90014, digest, "image/png", 20)
    coarse = TileEntry("semantic", 16, 34297, 22503, digest, "image/png", 20)
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        maps.ensure_map(session, "city")
        for base in range(2):
            publish(session, "city", NewVersion(base, (8.5, 49.5, 0.0), (), 1, (8.39, 49.0, 8.41, 49.02), [tile, coarse]), kept=5)
    database.close()
    return tile


def test_a_tile_comes_with_its_hash_and_is_not_sent_twice(http: httpx2.Client, published: TileEntry) -> None:
    path = f"/v1/maps/city/tiles/semantic/{published.z}/{published.x}/{published.y}.png"
    answer = http.get(path)
    assert (answer.status_code, answer.content, answer.headers["Content-Type"]) == (200, b"not really a picture", "image/png")
    assert answer.headers["ETag"] == f'"{published.digest}"'
    assert answer.headers["Cache-Control"] == "no-cache"
    for tag in (f'"{published.digest}"', f'W/"{published.digest}"', f'"other", "{published.digest}"', "*"):
        again = http.get(path, headers={"If-None-Match": tag})
        assert (again.status_code, again.content) == (304, b"")
    assert http.get(path, headers={"If-None-Match": '"other"'}).status_code == 200


def test_a_tile_of_a_version_never_changes(http: httpx2.Client, published: TileEntry) -> None:
    answer = http.get(f"/v1/maps/city/versions/1/tiles/semantic/{published.z}/{published.x}/{published.y}.png")
    assert answer.status_code == 200
    assert "immutable" in answer.headers["Cache-Control"]


def test_the_head_of_a_tile_is_its_headers_alone(http: httpx2.Client, published: TileEntry) -> None:
    for of in ("", "/versions/1"):
        path = f"/v1/maps/city{of}/tiles/semantic/{published.z}/{published.x}/{published.y}.png"
        answer, full = http.head(path), http.get(path)
        assert (answer.status_code, answer.content) == (200, b"")
        for name in ("ETag", "Content-Type", "Content-Length", "Cache-Control"):
            assert answer.headers[name] == full.headers[name]
    assert http.head("/v1/maps/city/tiles/semantic/3/1/1.png").status_code == 204


@pytest.mark.usefixtures("published")
def test_a_layer_is_described_to_viewers_by_addresses_that_answer(http: httpx2.Client, published: TileEntry) -> None:
    said = http.get("/v1/maps/city/tiles/semantic/tilejson.json").json()
    assert said == http.get("/v1/maps/city/versions/2/tiles/semantic/tilejson.json").json()
    assert (said["minzoom"], said["maxzoom"], said["bounds"]) == (16, 18, [8.39, 49.0, 8.41, 49.02])
    (address,) = said["tiles"]
    assert "/versions/2/" in address
    assert http.get(address.format(z=published.z, x=published.x, y=published.y)).content == b"not really a picture"
    gone = http.get("/v1/maps/city/tiles/ortho/tilejson.json")
    assert (gone.status_code, gone.json()["code"]) == (404, "not-found")
    assert "it has semantic" in gone.json()["detail"]
    assert http.get("/v1/maps/city/versions/9/tiles/semantic/tilejson.json").status_code == 404


@pytest.mark.usefixtures("published")
def test_wmts_capabilities_name_addresses_that_answer(http: httpx2.Client, published: TileEntry) -> None:
    for of in ("", "/versions/1"):
        answer = http.get(f"/v1/maps/city{of}/wmts.xml")
        assert (answer.status_code, answer.headers["Content-Type"]) == (200, "application/xml")
        (address,) = re.findall(r'template="([^"]*)"', answer.text)
        assert f"/v1/maps/city{of}/tiles/" in address
        place = {"TileMatrix": published.z, "TileCol": published.x, "TileRow": published.y}
        assert http.get(address.format(**place)).content == b"not really a picture"


@pytest.mark.usefixtures("published")
def test_where_nothing_is_mapped_there_is_no_content(http: httpx2.Client) -> None:
    assert http.get("/v1/maps/city/tiles/semantic/3/1/1.png").status_code == 204
    assert http.get("/v1/maps/city/tiles/features/3/1/1.mvt").status_code == 204


@pytest.mark.usefixtures("published")
@pytest.mark.parametrize(
    ("address", "status"),
    [
        ("3/8/0", 404), ("3/0/8", 404), ("0/1/0", 404), ("99/0/0", 422), ("-1/0/0", 422), ("3/-1/0", 422), ("a/0/0", 422),
        ("18/999999999999/0", 422),
    ],
)  # fmt: skip
def test_a_tile_that_cannot_be_is_refused(http: httpx2.Client, address: str, status: int) -> None:
    assert http.get(f"/v1/maps/city/tiles/semantic/{address}.png").status_code == status


@pytest.mark.usefixtures("published")
def test_versions_and_coverage_are_told(http: httpx2.Client) -> None:
    assert [version["version"] for version in http.get("/v1/maps/city/versions").json()["versions"]] == [2, 1]
    newest = http.get("/v1/maps/city").json()
    assert newest == http.get("/v1/maps/city/versions/2").json()
    assert newest["layers"]["semantic"]["max_zoom"] == 18
    assert http.get("/v1/maps/city/versions/9").status_code == 404
    (feature,) = http.get("/v1/maps/city/coverage?of=tiles").json()["features"]
    assert feature["properties"] == {"z": 16, "x": 34297, "y": 22503}
    (west, north), (east, south) = feature["geometry"]["coordinates"][0][3], feature["geometry"]["coordinates"][0][1]
    assert west < 8.4 < east
    assert south < 49.01 < north
    for of in ("streets", "tiles", "visits"):
        newest, same = (http.get(f"/v1/maps/city/coverage?of={of}{more}").json() for more in ("", "&version=2"))
        assert newest == same
        assert http.get(f"/v1/maps/city/coverage?of={of}&version=9").status_code == 404
