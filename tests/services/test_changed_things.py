"""The list of changed things: by box, by time, by version."""

import httpx2
import pytest

from services.conftest import ApiAlone
from wayloom.store import maps
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, RegionEntry, publish


def thing(kind: str, lon: float, noticed: str) -> dict[str, object]:
    place = {"type": "Point", "coordinates": [lon, 49.0, 110.0]}
    return {"type": "Feature", "geometry": place, "properties": {"kind": kind, "class": "pole", "noticed": noticed}}


OLD, YOUNG = thing("gone", 8.4, "2026-06-01T08:00:00.000Z"), thing("new", 8.5, "2026-06-02T08:00:00.250Z")


@pytest.fixture(scope="module", autouse=True)
def _versions(api_process: ApiAlone) -> None:
    """The first version lists one thing; the second lists another one beside it; the third has lost the first."""
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        maps.ensure_map(session, "street")
        for base, found in enumerate(([OLD], [OLD, YOUNG], [YOUNG])):
            region = RegionEntry(0, 0, f"{base}" * 64, f"{base}" * 64, [], 10, found)
            quiet = RegionEntry(1, 0, f"{base}" * 64, f"{base}" * 64, [], 10)
            version = NewVersion(base, (8.5, 49.5, 0.0), (), 0, None, [], regions=[region, quiet])
            publish(session, "street", version, kept=5)
    database.close()


def listed(http: httpx2.Client, **query: str) -> list[dict[str, object]]:
    answer = http.get("/v1/maps/street/changes", params=query)
    assert answer.status_code == 200
    assert answer.json()["type"] == "FeatureCollection"
    found: list[dict[str, object]] = answer.json()["features"]
    return found


def test_the_newest_version_lists_what_has_gone_and_is_new(http: httpx2.Client) -> None:
    assert listed(http) == [YOUNG]


def test_a_box_and_a_time_choose_among_them(http: httpx2.Client) -> None:
    assert listed(http, bbox="8.45,48.9,8.6,49.1") == [YOUNG]
    assert listed(http, bbox="8.3,48.9,8.45,49.1") == []
    assert listed(http, bbox="179.0,48.9,8.6,49.1") == [YOUNG]
    assert listed(http, since="2026-06-02T10:00:00.250+02:00") == [YOUNG]
    assert listed(http, since="2026-06-02T08:00:00.251Z") == []
    assert listed(http, until="2026-06-02T08:00:00.250Z") == [YOUNG]
    assert listed(http, since="2026-06-01T00:00:00Z", until="2026-06-02T08:00:00.249Z") == []


def test_a_version_says_what_it_lists_otherwise_than_the_one_before(http: httpx2.Client) -> None:
    said = [http.get(f"/v1/maps/street/versions/{number}/changes").json() for number in (1, 2, 3)]
    assert [one["things"]["features"] for one in said] == [[OLD], [YOUNG], []]
    assert [one["withdrawn_things"]["features"] for one in said] == [[], [], [OLD]]


@pytest.mark.parametrize("query", [{"since": "yesterday"}, {"since": "2026-06-02T08:00:00"}])
def test_a_time_that_is_none_is_refused(http: httpx2.Client, query: dict[str, str]) -> None:
    assert http.get("/v1/maps/street/changes", params=query).status_code == 422


def test_a_map_that_is_not_there_has_no_changes(http: httpx2.Client) -> None:
    assert http.get("/v1/maps/nowhere/changes").status_code == 404
    assert http.get("/v1/maps/street/changes", params={"bbox": "1,2,3"}).status_code == 400
