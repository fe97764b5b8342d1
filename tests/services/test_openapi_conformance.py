"""What the OpenAPI document says is what a real server does, for requests that follow it and for those that do not.

Each operation is asked with values by its schema, of which path parameters are mostly those of things that are there.
`WAYLOOM_CONFORMANCE_EXAMPLES=500 pytest tests/services/test_openapi_conformance.py` looks longer, and each time at others.
"""

import os
from collections.abc import Iterator
from typing import Any

import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi import checks

from service_kit.guarded import API_KEY, Guarded, bearer
from service_kit.lived_in import lived_in

schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
ASKED = os.environ.get("WAYLOOM_CONFORMANCE_EXAMPLES")
EXAMPLES = int(ASKED or 6)
THERE = 0.8
"""Share of path parameters that name something."""
STREAMS = {("GET", "/v1/events")}
"""What does not end."""
CHECKS = [
    schemathesis.checks.not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
]
Service = tuple[Guarded, dict[str, list[Any]], list[Any]]


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """The service, what there is, and its operations: those that take something away come last."""
    folder = tmp_path_factory.mktemp("lived-in")
    with lived_in(folder / "data", folder) as (guarded, known):
        schema = schemathesis.openapi.from_dict(guarded.http.get("/v1/openapi.json").json())
        found = [result.ok() for result in schema.get_all_operations()]
        ends = [one for one in found if (one.method.upper(), one.path) not in STREAMS]
        yield guarded, known, sorted(ends, key=lambda one: one.method.upper() == "DELETE")


@pytest.mark.parametrize("key", [API_KEY, None], ids=["admin", "nobody"])
@pytest.mark.parametrize("mode", [GenerationMode.POSITIVE, GenerationMode.NEGATIVE], ids=["by-the-schema", "against-it"])
def test_every_answer_is_one_that_the_document_tells_of(lived: Service, mode: GenerationMode, key: str | None) -> None:
    guarded, known, operations = lived
    assert len(operations) > 60
    problems = {}
    for operation in operations:
        try:
            ask(guarded.api.url, operation, mode, key, known)
        except BaseExceptionGroup as found:
            problems[operation.label] = "\n".join(map(str, found.exceptions))
        except Unsatisfiable:
            assert mode is GenerationMode.NEGATIVE, operation.label  # nothing can be wrong where nothing is taken
    assert problems == {}, "\n\n".join(f"{label}\n{text}" for label, text in problems.items())
    assert guarded.http.get("/readyz").status_code in (200, 503)


def ask(url: str, operation: Any, mode: GenerationMode, key: str | None, known: dict[str, list[Any]]) -> None:
    """The operation with made-up values, as often as is asked for. Raises what the checks find."""
    session = requests.Session()

    @settings(
        max_examples=EXAMPLES if key else max(2, EXAMPLES // 3), deadline=None, derandomize=ASKED is None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(operation.as_strategy(generation_mode=mode), st.data())
    def look(case: Any, data: Any) -> None:
        for name in list(case.path_parameters or {}):
            there = known.get(name, [])
            there = there[:1] if operation.method.upper() == "DELETE" else there
            if there and data.draw(st.floats(0, 1)) < THERE:
                case.path_parameters[name] = data.draw(st.sampled_from(there))
        answer = case.call(base_url=url, session=session, headers=dict(bearer(key)), timeout=30)
        case.validate_response(answer, checks=CHECKS)

    look()


def test_what_is_named_is_there(lived: Service) -> None:
    """Or the looks above would see refusals alone."""
    guarded, known, _ = lived
    http, drive = guarded.http, f"/v1/drives/{known['drive_id'][1]}"
    tile = "/".join(str(known[name][0]) for name in ("z", "x", "y"))
    paths = [drive, f"{drive}/quality", f"{drive}/track", "/v1/maps/city", "/v1/maps/town/versions/1/regions"]
    paths += [
        "/v1/maps/town/ogc/collections/objects/items",
        f"/v1/rigs/{known['key'][0]}",
        f"/v1/maps/city/tiles/semantic/{tile}.png",
    ]
    for path in paths:
        assert http.get(path).status_code == 200, path
