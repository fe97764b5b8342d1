"""Layers of a version over HTTP: 3D tiles, large pictures, styles, coverage; heads, ranges, and pages of other origins."""

import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import cv2
import httpx2
import numpy as np
import pytest

from service_kit.made_version import served_map
from service_kit.running import ApiAlone
from tiles.made_maps import made_map, made_tracks
from wayloom.config.service import ServiceSettings
from wayloom.geodesy import wgs84
from wayloom.tiles.gltf_points import decode_glb
from wayloom.tiles.grid import pixel_from_lonlat

PAGE = "https://maps.example"
KEY = "a key for the layers' test"


@pytest.fixture(scope="module")
def city():
    return made_map(1500, extent_m=40.0)


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory, city) -> Iterator[ApiAlone]:
    data = tmp_path_factory.mktemp("layers") / "data"
    parked = city.take(np.arange(0, len(city), 7))
    with closing(served_map(data, city, made_tracks(city), parked=parked, WAYLOOM_CORS_ORIGINS=PAGE)) as alone:
        yield alone


@pytest.fixture
def http(api: ApiAlone) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=f"{api.url}/v1/maps/city", timeout=30.0, trust_env=False) as client:
        yield client


def picture(data: bytes) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))


def test_a_large_picture_is_the_four_of_the_next_zoom(http: httpx2.Client, city) -> None:
    described = http.get("/tiles/semantic/tilejson.json?large=true").json()
    assert (described["tileSize"], described["maxzoom"]) == (512, 19)
    places = wgs84.lonlatheight_from_enu(city.points_enu, city.frame)[:, :2]
    x, y = (pixel_from_lonlat(places.mean(axis=0)[None], 19)[0] // 256).tolist()
    address = described["tiles"][0].format(z=19, x=x, y=y)
    assert "@2x.png" in address
    large = http.get(address)
    got = picture(large.content)
    assert got.shape == (512, 512, 4)
    for column in (0, 1):
        for row in (0, 1):
            one = http.get(f"/versions/1/tiles/semantic/20/{2 * x + column}/{2 * y + row}.png")
            part = got[row * 256 : row * 256 + 256, column * 256 : column * 256 + 256]
            assert (part == (picture(one.content) if one.status_code == 200 else 0)).all()
    again = http.get(address, headers={"If-None-Match": large.headers["ETag"]})
    assert (again.status_code, "immutable" in again.headers["Cache-Control"]) == (304, True)
    assert http.get(f"/tiles/semantic/20/{2 * x}/{2 * y}@2x.png").status_code == 204  # nothing is finer
    refused = http.get("/tiles/points/18/1/1@2x.wlp")
    assert (refused.status_code, "semantic" in refused.json()["detail"]) == (404, True)
    assert http.get("/tiles/points/tilejson.json?large=true").status_code == 404


@pytest.mark.parametrize(("folder", "step"), [("3dtiles", 1), ("3dtiles/parked", 7)])
def test_a_tileset_leads_to_every_voxel_by_addresses_that_never_change(http: httpx2.Client, city, folder: str, step: int) -> None:
    newest, numbered = http.get(f"/{folder}/tileset.json"), http.get(f"/versions/1/{folder}/tileset.json")
    assert (newest.headers["Cache-Control"], "immutable" in numbered.headers["Cache-Control"]) == ("no-cache", True)
    assert http.get(f"/{folder}/tileset.json", headers={"If-None-Match": newest.headers["ETag"]}).status_code == 304
    ways = []
    for answer in (newest, numbered):
        base = str(answer.url)
        waiting, contents = [(base, answer.json()["root"])], {}
        while waiting:
            at, tile = waiting.pop()
            uri = tile.get("content", {}).get("uri")
            waiting += [(at, child) for child in tile.get("children", ())]
            if uri is not None:
                address = httpx2.URL(at).join(uri)
                found = http.get(address)
                assert (found.status_code, "immutable" in found.headers["Cache-Control"]) == (200, True)
                if uri.endswith(".json"):
                    assert found.headers["Content-Type"] == "application/json"
                    waiting.append((str(address), found.json()["root"]))
                else:
                    assert found.headers["Content-Type"] == "model/gltf-binary"
                    contents[str(address)] = (tile["geometricError"], decode_glb(found.content))
        ways.append(sorted(contents))
        assert sum(len(points) for error, points in contents.values() if error == 0.0) == len(
            city.take(np.arange(0, len(city), step))
        )
    assert ways[0] == ways[1]


def test_an_overlay_that_a_version_has_nothing_of_has_no_tileset(http: httpx2.Client) -> None:
    assert http.get("/3dtiles/unconfirmed/tileset.json").status_code == 404
    assert http.get("/3dtiles/moving/tileset.json").status_code == 422


def test_every_tile_is_at_most_a_megabyte(api: ApiAlone, http: httpx2.Client) -> None:
    changed = http.get("/versions/1/changes").json()["changed"]
    assert {one["layer"] for one in changed} >= {"cloud", "tilesets", "semantic", "features", "points"}
    assert max(one["bytes"] for one in changed) <= 1_000_000


@pytest.mark.parametrize(
    "path",
    [
        "", "/versions", "/versions/1", "/coverage", "/tiles/semantic/tilejson.json", "/style.json", "/versions/1/style.json",
        "/wmts.xml", "/3dtiles/tileset.json", "/versions/1/3dtiles/tileset.json", "/tiles/semantic/3/1/1.png",
    ],
)  # fmt: skip
def test_the_head_of_what_a_map_is_read_by_is_its_headers_alone(http: httpx2.Client, path: str) -> None:
    address = str(http.base_url).rstrip("/") + path
    answer, full = http.head(address), http.get(address)
    assert (answer.status_code, answer.content) == (full.status_code, b"")
    assert answer.status_code in (200, 204)
    for name in ("ETag", "Content-Type", "Content-Length", "Cache-Control"):
        assert answer.headers.get(name) == full.headers.get(name)


def test_heads_are_counted_as_heads_of_their_routes(api: ApiAlone, http: httpx2.Client) -> None:
    http.head("/style.json")
    http.head("/tiles/semantic/3/1/1.png")
    text = httpx2.get(f"{api.url}/metrics", trust_env=False).text
    assert 'method="HEAD",route="/v1/maps/{map_id}/style.json",status="200"' in text
    assert 'method="HEAD",route="/v1/maps/{map_id}/tiles/{layer}/{z}/{x}/{y}.{ext}",status="204"' in text


def test_addresses_beyond_their_zoom_are_refused_before_the_database_is_asked(http: httpx2.Client) -> None:
    """A map that is not there would be 404 by another word."""
    elsewhere = str(http.base_url).rstrip("/").replace("/city", "/nowhere")
    for path in ("tiles/semantic/3/8/0.png", "tiles/semantic/3/0/8.png", "versions/4/tiles/cloud/12/4096/0.glb"):
        answer = http.get(f"{elsewhere}/{path}")
        assert (answer.status_code, "both go from 0" in answer.json()["detail"]) == (404, True)
    assert http.get(f"{elsewhere}/tiles/nothing/3/1/1.png").status_code == 204
    assert "there is no map" in http.get(f"{elsewhere}/tiles/semantic/3/1/1.png").json()["detail"]


def test_the_style_names_layers_that_the_version_has_and_nothing_from_elsewhere(api: ApiAlone, http: httpx2.Client) -> None:
    style = http.get("/style.json").json()
    assert style["version"] == 8
    assert set(style["sources"]) == {"semantic", "features", "parked"}
    assert {layer["source"] for layer in style["layers"] if "source" in layer} == set(style["sources"])
    assert not {"sprite", "glyphs"} & set(style)
    assert all(
        address.startswith(f"{api.url}/v1/maps/city/versions/1/") for one in style["sources"].values() for address in one["tiles"]
    )
    assert style["sources"]["features"]["type"] == "vector"
    assert http.get("/versions/1/style.json").json() == style
    assert http.get("/versions/9/style.json").status_code == 404


def test_pages_of_allowed_origins_may_read_and_no_others(api: ApiAlone, http: httpx2.Client) -> None:
    ask = {"Origin": PAGE, "Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "authorization"}
    for path in ("/style.json", "/tiles/semantic/3/1/1.png", "/3dtiles/tileset.json"):
        before = http.options(path, headers=ask)
        assert (before.status_code, before.headers["Access-Control-Allow-Origin"]) == (200, PAGE)
        assert "authorization" in before.headers["Access-Control-Allow-Headers"].lower()
        answer = http.get(path, headers={"Origin": PAGE})
        assert answer.headers["Access-Control-Allow-Origin"] == PAGE
        assert "etag" in answer.headers["Access-Control-Expose-Headers"].lower()
        assert "Origin" in answer.headers["Vary"]
        assert "Access-Control-Allow-Credentials" not in {**before.headers, **answer.headers}
        assert "Access-Control-Allow-Origin" not in http.get(path, headers={"Origin": "https://other.example"}).headers
        assert http.options(path, headers=ask | {"Origin": "https://other.example"}).status_code == 400
    assert http.options("/style.json", headers=ask | {"Access-Control-Request-Method": "DELETE"}).status_code == 400


def test_without_origins_no_page_of_another_may_read(api_process: ApiAlone) -> None:
    ask = {"Origin": PAGE, "Access-Control-Request-Method": "GET"}
    with httpx2.Client(base_url=api_process.url, timeout=30.0, trust_env=False) as client:
        for answer in (client.options("/v1/maps", headers=ask), client.get("/v1/maps", headers=ask)):
            assert not [name for name in answer.headers if name.lower().startswith("access-control")]


def test_a_preflight_needs_no_key_and_what_follows_does(tmp_path: Path) -> None:
    ask = {"Origin": PAGE, "Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "authorization"}
    with (
        closing(ApiAlone(tmp_path / "data", WAYLOOM_API_KEY=KEY, WAYLOOM_CORS_ORIGINS="*")) as alone,
        httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as client,
    ):
        before = client.options("/v1/maps", headers=ask)
        assert (before.status_code, before.headers["Access-Control-Allow-Origin"]) == (200, "*")
        refused = client.get("/v1/maps", headers={"Origin": PAGE})
        assert (refused.status_code, refused.headers["Access-Control-Allow-Origin"]) == (401, "*")
        assert client.get("/v1/maps", headers={"Origin": PAGE, "Authorization": f"Bearer {KEY}"}).status_code == 200


@pytest.mark.parametrize("origin", ["maps.example", "https://maps.example/", "https://*.example", "null"])
def test_what_is_no_origin_is_refused(origin: str) -> None:
    with pytest.raises(ValueError, match="is no origin"):
        ServiceSettings(cors_origins=(origin,))


def test_the_openapi_document_has_every_new_address(api: ApiAlone) -> None:
    paths = httpx2.get(f"{api.url}/v1/openapi.json", trust_env=False).json()["paths"]
    for of in ("", "/versions/{number}"):
        for path in ("/3dtiles/tileset.json", "/style.json", "/tiles/{layer}/{z}/{x}/{y}@2x.{ext}", "/tiles/{layer}/tilejson.json"):
            operation = paths[f"/v1/maps/{{map_id}}{of}{path}"]["get"]
            assert operation["description"]
    assert "model/gltf-binary" in json.dumps(paths["/v1/maps/{map_id}/tiles/{layer}/{z}/{x}/{y}.{ext}"])
