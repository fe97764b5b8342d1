"""The list of markings and kerbs of a version: by box, page by page."""

from collections.abc import Iterator

import httpx2
import numpy as np
import pytest

from services.conftest import ApiAlone
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.marking_files import encode_features
from wayloom.stitching.region_grid import RegionKey
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.map_versions import NewVersion, RegionEntry, publish

FRAME = MapFrame(179.9995, 49.0, 0.0)
"""Half a minute's walk from the antimeridian."""


def line(kind: str, x: float, y: float, length_m: float = 3.0) -> dict[str, object]:
    """A line to the east from a place of the frame."""
    places = wgs84.lonlatheight_from_enu(np.array([[x, y, 0.0], [x + length_m, y, 0.0]]), FRAME).tolist()
    return {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": places},
        "properties": {"kind": kind, "name": f"{x},{y}"},
    }


WEST, EAST = [line("dash", 1.0 + 6.0 * k, 5.0) for k in range(7)], [line("kerb", 70.0, 9.0, 15.0), line("dash", 66.0, 5.0)]


@pytest.fixture(scope="module", autouse=True)
def _versions(api_process: ApiAlone) -> Iterator[None]:
    """The first version has markings in one region; the second in two, and a region without."""
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    blobs = BlobStore(Folders(api_process.data).blobs)

    def region(key: RegionKey, features: list[dict[str, object]]) -> RegionEntry:
        return RegionEntry(*key, "1" * 64, "1" * 64, [], 10, [], "", blobs.put(encode_features(features)) if features else "")

    with database.write() as session:
        maps.ensure_map(session, "painted")
        for base, regions in enumerate(([region((0, 0), WEST)], [region((1, 0), EAST), region((2, 0), [])])):
            frame = (FRAME.lon_deg, FRAME.lat_deg, FRAME.height_m)
            publish(session, "painted", NewVersion(base, frame, (), 0, None, [], regions=regions), kept=5)
    yield
    database.close()


def asked(http: httpx2.Client, number: int, **query: str) -> dict[str, object]:
    answer = http.get(f"/v1/maps/painted/versions/{number}/markings", params=query)
    assert answer.status_code == 200, answer.text
    assert answer.json()["type"] == "FeatureCollection"
    found: dict[str, object] = answer.json()
    return found


def test_a_version_lists_what_it_has_and_no_more(http: httpx2.Client) -> None:
    assert asked(http, 1) == {"type": "FeatureCollection", "features": WEST, "next": None}
    assert asked(http, 2)["features"] == [*WEST, *EAST]


@pytest.mark.parametrize("limit", [1, 3, 7, 8, 9, 100])
def test_pages_give_each_once_and_in_order(http: httpx2.Client, limit: int) -> None:
    found: list[object] = []
    after: dict[str, str] = {}
    for _ in range(20):
        page = asked(http, 2, limit=str(limit), **after)
        assert len(page["features"]) <= limit  # type: ignore[arg-type]
        found += page["features"]  # type: ignore[misc]
        if page["next"] is None:
            break
        after = {"after": str(page["next"])}
    assert found == [*WEST, *EAST]


def test_a_box_chooses_those_that_reach_into_it_across_the_antimeridian_too(http: httpx2.Client) -> None:
    def box(x: float, y: float, x2: float, y2: float) -> str:
        (west, south, _), (east, north, _) = wgs84.lonlatheight_from_enu(np.array([[x, y, 0.0], [x2, y2, 0.0]]), FRAME).tolist()
        return f"{west},{south},{east},{north}"

    assert asked(http, 2, bbox=box(0.0, 4.0, 8.0, 6.0))["features"] == WEST[:2]
    assert asked(http, 2, bbox=box(30.0, 4.0, 69.0, 6.0))["features"] == [WEST[5], WEST[6], EAST[1]]
    assert asked(http, 2, bbox=box(84.0, 8.0, 90.0, 10.0))["features"] == EAST[:1]
    assert asked(http, 2, bbox="8.0,48.0,9.0,50.0")["features"] == []
    two = asked(http, 2, bbox=box(0.0, 4.0, 8.0, 6.0), limit="1")
    assert asked(http, 2, bbox=box(0.0, 4.0, 8.0, 6.0), limit="1", after=str(two["next"]))["features"] == [WEST[1]]


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ({"limit": "0"}, 422),
        ({"limit": "5001"}, 422),
        ({"after": "1,2"}, 422),
        ({"bbox": "1,2,3"}, 400),
        ({"bbox": "0,9,1,8"}, 400),
    ],
)
def test_a_query_that_is_none_is_refused(http: httpx2.Client, query: dict[str, str], status: int) -> None:
    assert http.get("/v1/maps/painted/versions/1/markings", params=query).status_code == status


def test_a_version_that_is_not_there_has_no_markings(http: httpx2.Client) -> None:
    assert http.get("/v1/maps/painted/versions/9/markings").status_code == 404
    assert http.get("/v1/maps/nowhere/versions/1/markings").status_code == 404
