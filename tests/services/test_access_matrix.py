"""Every route, every role, own things and others': one table, made from the routes' needs, tried on a real service."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from service_kit.guarded import OURS, THEIRS, Guarded, bearer
from wayloom.config.roles import RIGHTS, Right, Role
from wayloom.config.service import ServiceSettings
from wayloom_services.access.needs import NEEDS, SESSION, STATIC, Need, Open, asked
from wayloom_services.app import create_app

CALLERS: dict[str, tuple[Role | None, str | None]] = {
    "nobody": (None, None),
    "vehicle": (Role.VEHICLE, OURS),
    "other vehicle": (Role.VEHICLE, THEIRS),
    "viewer": (Role.VIEWER, None),
    "operator": (Role.OPERATOR, None),
    "admin": (Role.ADMIN, None),
}
EXPECTED = {
    Right.FOLLOW: {"vehicle", "other vehicle", "viewer", "operator", "admin"},
    Right.SEND: {"vehicle", "other vehicle", "operator", "admin"},
    Right.READ: {"viewer", "operator", "admin"},
    Right.OPERATE: {"operator", "admin"},
    Right.MANAGE: {"admin"},
}
"""Written out, so that a right that is given away by mistake fails here."""
OF_ONE = ("/v1/drives/{drive_id}", "/v1/uploads/{upload_id}")
PLACES = {
    "map_id": "city", "number": "1", "layer": "semantic", "z": "0", "x": "0", "y": "0", "ext": "png", "name": "objects",
    "feature_id": "1", "base": "0", "east": "0", "north": "0", "part": "voxels", "digest": "0" * 64, "key": "0" * 32,
    "picture": "track", "prefix": "0" * 12, "area_id": "0" * 32, "overlay": "parked",
}  # fmt: skip
MATRIX = [
    pytest.param(template, method, need, caller, id=f"{method} {template} by {caller}")
    for template, methods in NEEDS.items()
    for method, need in methods.items()
    for caller in CALLERS
]


@dataclass(frozen=True)
class World:
    """A service, the callers' keys, and a drive and an upload of our vehicle."""

    service: Guarded
    keys: dict[str, str | None]
    drive: str
    upload: str


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    service = Guarded(tmp_path_factory.mktemp("guarded") / "data", WAYLOOM_ACCESS__STRANGERS_AT_ONCE="10000")
    keys = {name: None if role is None else service.key(role, vehicle) for name, (role, vehicle) in CALLERS.items()}
    drive = service.drive(str(keys["vehicle"]))
    yield World(service, keys, drive, service.upload(str(keys["vehicle"]), drive))
    service.close()


def routes(found: Any) -> Iterator[tuple[str, str]]:
    """Template and method of every route of an application."""
    for route in found:
        if hasattr(route, "effective_route_contexts"):
            yield from routes(route.effective_route_contexts())
        elif route.path != STATIC.rstrip("/"):
            yield from ((route.path, method) for method in route.methods)


def test_every_route_of_the_application_is_in_the_table_and_nothing_else(tmp_path: Path) -> None:
    there = set(routes(create_app(ServiceSettings(data_dir=tmp_path)).routes))
    told = {(template, method) for template, methods in NEEDS.items() for method in methods}
    assert {one for one in there - told if one[1] != "HEAD"} == set()
    assert told - there == set()
    assert len(told) > 70


def test_a_path_is_known_by_one_template_alone_or_by_several_of_one_need() -> None:
    for template, methods in NEEDS.items():
        path = template.format(**PLACES, drive_id="d" * 64, upload_id="u" * 32)
        for method, need in methods.items():
            found = asked(method, path)
            assert found is not None
            assert found.need == need


@pytest.mark.parametrize(("template", "method", "need", "caller"), MATRIX)
def test_a_route_answers_those_alone_who_have_the_right(world: World, template: str, method: str, need: Need, caller: str) -> None:
    key, owns = world.keys[caller], caller != "other vehicle"
    may = need is Open.TO_ALL or caller in (EXPECTED[need] if isinstance(need, Right) else CALLERS.keys() - {"nobody"})
    drive, upload = world.drive, world.upload
    if method == "DELETE" and may and template in OF_ONE:
        drive = world.service.drive(str(world.keys["vehicle"]))
        upload = world.service.upload(str(world.keys["vehicle"]), drive)
    path = template.format(**PLACES, drive_id=drive, upload_id=upload)
    headers = {**bearer(key), "Tus-Resumable": "1.0.0", "X-Requested-With": "wayloom"}
    with world.service.http.stream(method, path, headers=headers) as answer:
        status = answer.status_code
        said = "" if template == "/v1/events" and status == 200 else answer.read().decode("utf-8", "replace")
    if not may:
        assert (status, "code" in said or method == "HEAD") == (401 if key is None else 403, True)
    elif template.startswith(OF_ONE) and not owns:
        assert status == 404
        assert method == "HEAD" or "there is no drive" in said or "there is no such upload" in said
    else:
        assert status not in (401, 403, 405, 429, 500, 503)
        assert "there is no drive" not in said
        assert "there is no such upload" not in said


def test_the_rights_of_the_roles_are_those_of_the_table() -> None:
    for name, (role, _) in CALLERS.items():
        rights = frozenset() if role is None else RIGHTS[role]
        assert {right for right in Right if name in EXPECTED[right]} == rights, name


def test_the_openapi_document_tells_of_each_operation_who_may_and_what_is_answered_to_others(world: World) -> None:
    document = world.service.http.get("/v1/openapi.json").json()
    assert set(document["components"]["securitySchemes"]) == {"key", "session"}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            need, answers = NEEDS[path][method.upper()], operation["responses"]
            assert "429" in answers, (path, method)
            may_refuse = need is not Open.TO_ALL or (path, method) == (SESSION, "post")  # a sign-in is refused for what it says
            assert ({"401", "403"} <= answers.keys()) == may_refuse, (path, method)
            assert bool(operation["security"]) == (need is not Open.TO_ALL)
            assert not ("{" in path and need in (Right.FOLLOW, Right.SEND, Right.OPERATE)) or "404" in answers, (path, method)
            if isinstance(need, Right):
                assert set(operation["x-wayloom-roles"]) == {role for role, _ in CALLERS.values() if role and need in RIGHTS[role]}
