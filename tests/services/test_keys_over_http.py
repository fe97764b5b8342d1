"""Keys over HTTP: made, rotated and revoked by admins; what a vehicle's key sees and sends; and what is written down of it all."""

import json
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest

from service_kit.guarded import API_KEY, OURS, THEIRS, Guarded, bearer
from service_kit.running import until
from service_kit.tus import V, create
from wayloom.config.roles import Role

HELD_S = 2.0


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    guarded = Guarded(tmp_path_factory.mktemp("guarded") / "data", WAYLOOM_ACCESS__HELD_S=str(HELD_S))
    yield guarded
    guarded.close()


@pytest.fixture(scope="module")
def ours(service: Guarded) -> str:
    return service.key(Role.VEHICLE, OURS)


@pytest.fixture(scope="module")
def theirs(service: Guarded) -> str:
    return service.key(Role.VEHICLE, THEIRS)


def status(service: Guarded, key: str | None, path: str = "/v1/drives") -> int:
    return service.http.get(path, headers=bearer(key)).status_code


def audit(service: Guarded, **query: Any) -> list[dict[str, Any]]:
    answer = service.http.get("/v1/audit", params=query, headers=bearer(API_KEY))
    assert answer.status_code == 200, answer.text
    found: list[dict[str, Any]] = answer.json()["entries"]
    return found


def test_a_key_is_shown_once_rotated_with_a_grace_and_revoked_at_once(service: Guarded) -> None:
    admin = bearer(API_KEY)
    wanted = {"name": "the van's computer", "role": "vehicle", "vehicle_id": OURS, "expires_in_s": 3600}
    made = service.http.post("/v1/keys", json=wanted, headers=admin)
    assert made.status_code == 201
    first, prefix = made.json()["key"], made.json()["prefix"]
    assert first.startswith(f"wlk_{prefix}_")
    listed = service.http.get("/v1/keys", headers=admin)
    assert first.split("_", 2)[2] not in listed.text
    assert next(one for one in listed.json()["keys"] if one["prefix"] == prefix)["vehicle_id"] == OURS
    assert status(service, first) == 200
    second = service.http.post(f"/v1/keys/{prefix}/rotate", json={"grace_s": 3600}, headers=admin).json()["key"]
    assert [status(service, key) for key in (first, second)] == [200, 200]
    third = service.http.post(f"/v1/keys/{prefix}/rotate", json={"grace_s": 0}, headers=admin).json()["key"]
    assert [status(service, key) for key in (first, second, third)] == [401, 401, 200]
    assert service.http.delete(f"/v1/keys/{prefix}", headers=admin).json()["revoked_at"] is not None
    assert status(service, third) == 401
    assert service.http.delete(f"/v1/keys/{prefix}", headers=admin).status_code == 409
    assert [one["action"].partition(" ")[0] for one in audit(service, limit=500) if one["object"].endswith(prefix)] == [
        "DELETE", "DELETE", "POST", "POST", "POST",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "wanted",
    [
        {"name": "x", "role": "king"}, {"role": "viewer"}, {"name": "x", "role": "viewer", "secret": "mine"},
        {"name": "x", "role": "viewer", "prefix": "0" * 12}, {"name": "x", "role": "vehicle", "expires_in_s": -1},
    ],
)  # fmt: skip
def test_a_key_that_is_asked_for_wrongly_is_not_made(service: Guarded, wanted: dict[str, Any]) -> None:
    assert service.http.post("/v1/keys", json=wanted, headers=bearer(API_KEY)).status_code == 422


def test_an_expired_key_is_refused_also_where_it_was_held_in_memory(service: Guarded) -> None:
    key = service.key(Role.VIEWER, expires_in_s=1.0)
    assert status(service, key) == 200
    until(lambda: status(service, key) == 401, 10)


def test_a_key_that_another_process_revokes_is_refused_within_the_time_that_it_is_held(service: Guarded) -> None:
    key = service.key(Role.VIEWER)
    assert status(service, key) == 200
    from wayloom.store.access import keys

    with service.database.write() as session:
        keys.revoke(session, key.split("_")[1])
    until(lambda: status(service, key) == 401, 2 * HELD_S + 5)


def test_the_key_of_the_settings_goes_on_as_an_admins(service: Guarded) -> None:
    me = service.http.get("/v1/session", headers=bearer(API_KEY)).json()
    assert (me["name"], me["role"], me["signed_in"]) == ("api key", "admin", False)
    assert [status(service, key) for key in (API_KEY + "x", API_KEY[:-1], "x", None)] == [401] * 4


def test_a_vehicle_lists_and_hears_of_its_own_drives_alone(service: Guarded, ours: str, theirs: str) -> None:
    own, other = service.drive(ours), service.drive(theirs)
    listed = [one["id"] for one in service.http.get("/v1/drives", headers=bearer(ours)).json()["drives"]]
    assert own in listed
    assert other not in listed
    heard = []
    with service.http.stream("GET", "/v1/events", headers=bearer(theirs)) as answer:
        for line in answer.iter_lines():
            if line.startswith("event: "):
                assert line == "event: drive"
            if line.startswith("data: "):
                heard.append(json.loads(line.removeprefix("data: "))["id"])
                if len(heard) == 1:
                    service.drive(ours)  # is not heard
                    last = service.drive(theirs)
                if heard[-1:] == [last]:
                    break
    everything = {one["id"] for one in service.http.get("/v1/drives", headers=bearer(API_KEY)).json()["drives"]}
    assert set(heard) == {one["id"] for one in service.http.get("/v1/drives", headers=bearer(theirs)).json()["drives"]}
    assert set(heard) < everything


def test_a_vehicle_sends_under_no_other_vehicles_name(service: Guarded, ours: str) -> None:
    refused = service.announce(ours, vehicle_id=THEIRS)
    assert (refused.status_code, refused.json()["code"]) == (403, "wrong-vehicle")
    assert service.announce(ours, vehicle_id=OURS).json()["drive"]["vehicle_id"] == OURS
    assert service.announce(ours).json()["drive"]["vehicle_id"] == OURS
    for name, value in (("owner", "vehicle van-2"), ("state", "done"), ("map_id", "other")):
        assert service.announce(ours, **{name: value}).status_code == 422


def test_a_vehicle_uploads_to_no_other_vehicles_drive_and_learns_nothing_of_it(service: Guarded, ours: str, theirs: str) -> None:
    drive = service.drive(ours)
    upload = service.upload(ours, drive)
    begun = create(service.http, drive, "log/a", 10, **bearer(theirs))
    unknown = create(service.http, "f" * 64, "log/a", 10, **bearer(theirs))
    assert begun.status_code == unknown.status_code == 404
    assert begun.json()["detail"].replace(drive, "") == unknown.json()["detail"].replace("f" * 64, "")
    for method in ("HEAD", "PATCH", "DELETE"):
        sent = {**V, **bearer(theirs), "Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
        assert service.http.request(method, f"/v1/uploads/{upload}", headers=sent).status_code == 404
    for method in ("PATCH", "DELETE"):
        by_post = {**sent, "X-HTTP-Method-Override": method}
        assert service.http.post(f"/v1/uploads/{upload}", headers=by_post).status_code == 404
    assert service.http.head(f"/v1/uploads/{upload}", headers={**V, **bearer(ours)}).headers["Upload-Offset"] == "0"
    manifest = {"name": "the same", "files": [{"path": "log/a", "size": 1, "sha256": "a" * 64}]}
    assert service.http.post("/v1/drives", json=manifest, headers=bearer(ours)).status_code == 201
    again = service.http.post("/v1/drives", json=manifest, headers=bearer(theirs))
    assert (again.status_code, again.json()["code"]) == (409, "conflict")


def test_keys_of_one_vehicle_share_its_drives_and_a_key_of_none_has_its_own(service: Guarded, ours: str) -> None:
    drive, unbound = service.drive(ours), service.key(Role.VEHICLE)
    assert status(service, service.key(Role.VEHICLE, OURS), f"/v1/drives/{drive}") == 200
    assert status(service, unbound, f"/v1/drives/{drive}") == 404
    assert status(service, unbound, f"/v1/drives/{service.drive(unbound)}") == 200


def test_changes_and_refusals_are_in_the_audit_log_and_reads_are_not(service: Guarded, ours: str) -> None:
    operator, viewer = service.key(Role.OPERATOR), service.key(Role.VIEWER)
    drive = service.drive(ours)
    service.http.post(f"/v1/drives/{drive}/cancel", headers=bearer(operator))
    (entry,) = audit(service, actor=f"key {operator.split('_')[1]}")
    assert entry["at"] > 1e9
    told = {name: entry[name] for name in ("role", "action", "object", "address", "status", "outcome")}
    assert told == {
        "role": "operator", "action": "POST /v1/drives/{drive_id}/cancel", "object": drive, "address": "127.0.0.1", "status": 409,
        "outcome": "failed",
    }  # fmt: skip
    service.http.get("/v1/drives", headers=bearer(viewer))
    for _ in range(3):
        service.http.delete(f"/v1/drives/{drive}", headers=bearer(viewer))
    service.http.get(f"/v1/drives/{drive}", headers=bearer(service.key(Role.VEHICLE, THEIRS)))
    found = until(lambda: audit(service, actor=f"key {viewer.split('_')[1]}"))
    assert {one["action"] for one in found} == {"DELETE /v1/drives/{drive_id}"}
    assert sum(one["count"] for one in found) == 3
    assert {(one["status"], one["outcome"], one["object"]) for one in found} == {(403, "refused", drive)}
    assert [one for one in audit(service, outcome="refused", limit=500) if one["status"] == 404 and one["object"] == drive]
    ours_of = audit(service, actor=f"key {ours.split('_')[1]}", limit=500)
    assert ("POST /v1/drives", drive) in {(one["action"], one["object"]) for one in ours_of}
    assert not [one for one in ours_of if one["action"].startswith("GET") and one["outcome"] == "done"]


def test_strangers_are_written_down_without_what_they_asked_for(service: Guarded) -> None:
    service.http.get("/v1/drives/" + "e" * 64)
    until(lambda: [one for one in audit(service, actor="nobody") if one["action"] == "GET /v1/drives/{drive_id}"])
    assert not [one for one in audit(service, actor="nobody", limit=500) if one["object"]]


def test_the_audit_log_is_read_page_by_page(service: Guarded) -> None:
    pages, before = [], None
    while True:
        page = service.http.get(
            "/v1/audit", params={"limit": 7} | ({} if before is None else {"before": before}), headers=bearer(API_KEY)
        )
        pages.append(page.json()["entries"])
        before = page.json()["next"]
        if before is None:
            break
    ids = [one["id"] for entries in pages for one in entries]
    assert ids == sorted(set(ids), reverse=True)
    assert len(ids) == ids[0]


def test_a_page_of_another_origin_changes_nothing_also_on_this_machine(api_process: Any, http: httpx2.Client) -> None:
    """Without any key, where being on this machine is all that it takes."""
    for origin, code in (("https://evil.example", 403), ("null", 403), (api_process.url, 404), (None, 404)):
        headers = {} if origin is None else {"Origin": origin}
        answer = http.post(f"/v1/drives/{'e' * 64}/cancel", headers=headers)
        assert answer.status_code == code, origin
        assert http.get("/v1/drives", headers=headers).status_code == 200
