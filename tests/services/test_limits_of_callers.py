"""Rates, quotas, streams that end, and the trail to the audit log."""

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from sse_starlette import ServerSentEvent

from service_kit.guarded import API_KEY, OURS, Guarded, bearer
from service_kit.tus import create
from wayloom.client.api import AnswerError, Api
from wayloom.config.backoff import Backoff
from wayloom.config.roles import Role
from wayloom.config.service import ServiceSettings
from wayloom.errors import ConfigError
from wayloom.store.access import keys
from wayloom.store.access.audit import Noted, page
from wayloom.store.database import Database, DatabaseError, Session
from wayloom.store.migrate import upgrade
from wayloom_services.access.buckets import TokenBuckets
from wayloom_services.access.callers import Callers, Credential
from wayloom_services.access.streams import _as_soon_as_it_answers, while_allowed
from wayloom_services.access.trail import Trail
from wayloom_services.errors import ProtocolError

ENTRY = Noted(1.0, "nobody", None, "GET /v1/drives", "", "10.0.0.1", 401, "refused")


def test_a_bucket_gives_its_burst_then_its_rate_and_says_how_long_to_wait() -> None:
    now = 0.0
    buckets = TokenBuckets(2.0, 3, most=2, clock=lambda: now)
    assert [buckets.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert buckets.take("b") == 0.0
    now = 0.25
    assert buckets.take("a") == pytest.approx(0.25)  # what was refused costs nothing
    now = 0.5
    assert [buckets.take("a"), buckets.take("a")] == [0.0, 0.5]
    now = 1000.0
    assert [buckets.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    for name in "bc":
        buckets.take(name)
    assert buckets.take("a") == 0.0  # forgotten, as the idlest of three


def test_floods_of_a_key_and_of_strangers_are_refused_and_nobody_else_is(tmp_path: Path) -> None:
    few = {"WAYLOOM_ACCESS__REQUESTS_AT_ONCE": "20", "WAYLOOM_ACCESS__REQUESTS_A_SECOND": "0.1"}
    strange = {"WAYLOOM_ACCESS__STRANGERS_AT_ONCE": "10", "WAYLOOM_ACCESS__STRANGERS_A_SECOND": "0.1"}
    with closing(Guarded(tmp_path / "data", **few, **strange)) as service:
        flood, quiet = service.key(Role.VIEWER), service.key(Role.VIEWER)
        answers = [service.http.get("/v1/drives", headers=bearer(flood)) for _ in range(25)]
        assert [answer.status_code for answer in answers] == [200] * 20 + [429] * 5
        assert answers[-1].json()["code"] == "too-many"
        assert 1 <= int(answers[-1].headers["Retry-After"]) <= 11
        here = [service.http.get("/v1/drives", headers=bearer(f"wlk_{k:012}_x")).status_code for k in range(15)]
        assert here == [401] * 10 + [429] * 5
        assert service.http.get("/healthz").status_code == 429
        there = service.http.get("/healthz", headers={"X-Forwarded-For": "10.0.0.9"})
        assert there.status_code == 200
        assert service.http.get("/v1/drives", headers=bearer(quiet)).status_code == 200  # from the same address


def test_a_vehicle_that_has_sent_enough_is_told_when_it_may_go_on(tmp_path: Path) -> None:
    limits = {"WAYLOOM_ACCESS__DRIVES_A_DAY": "3", "WAYLOOM_ACCESS__BYTES_A_DAY": "1000", "WAYLOOM_ACCESS__OPEN_BYTES": "25"}
    with closing(Guarded(tmp_path / "data", **limits)) as service:
        ours, operator = service.key(Role.VEHICLE, OURS), service.key(Role.OPERATOR)
        drive = service.drive(ours)
        again = [create(service.http, drive, "log/a", 10, **bearer(ours)).status_code for _ in range(3)]
        assert again == [201, 201, 429]  # of one file, to fill the disk with
        large = service.announce(ours, size=16)
        assert (large.status_code, large.json()["code"], large.headers["Retry-After"]) == (429, "quota-exceeded", "60")
        assert [service.announce(ours, size=1).status_code for _ in range(3)] == [201, 201, 429]
        assert service.announce(ours, size=1).headers["Retry-After"] > "8"
        assert service.announce(operator, size=10_000).status_code == 201
        with Api(service.api.url, ours, retries=Backoff(1.0, 60.0, 9)) as api:
            started = time.monotonic()
            with pytest.raises(AnswerError, match="3 drives within 24 hours"):  # a client does not wait for tomorrow
                api.json("POST", "/v1/drives", json={"name": "x", "files": [{"path": "log/a", "size": 1, "sha256": "a" * 64}]})
            assert time.monotonic() - started < 0.9


@pytest.mark.parametrize("is_silent", [True, False])
def test_a_stream_ends_soon_after_its_listener_may_hear_no_more(is_silent: bool) -> None:
    allowed = [True, True, False]

    async def messages() -> AsyncIterator[ServerSentEvent]:
        while True:
            await asyncio.sleep(1000.0 if is_silent else 0.001)
            yield ServerSentEvent("x", event="drive")

    async def is_still() -> bool:
        return allowed.pop(0)

    async def heard() -> int:
        return len([message async for message in while_allowed(messages(), is_still, 0.05)])

    count = asyncio.run(asyncio.wait_for(heard(), 20.0))
    assert (count == 0) == is_silent
    assert allowed == []


def test_a_stream_goes_on_while_nobody_can_say_whether_its_listener_may_still_hear() -> None:
    answers: list[bool | Exception] = [True, ProtocolError(503, "away", "the database does not answer"), True, False]

    async def messages() -> AsyncIterator[ServerSentEvent]:
        while True:
            await asyncio.sleep(0.001)
            yield ServerSentEvent(str(len(answers)), event="drive")

    async def is_still() -> bool:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def heard() -> set[str]:
        return {str(message.data) async for message in while_allowed(messages(), is_still, 0.05)}

    assert asyncio.run(asyncio.wait_for(heard(), 20.0)) >= {"2", "1"}
    assert answers == []


def test_a_message_waits_for_a_database_that_is_away() -> None:
    answers: list[bool | Exception] = [DatabaseError("away"), DatabaseError("away"), True]

    async def ask() -> bool:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    assert asyncio.run(_as_soon_as_it_answers(ask, 0.001))


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    found = Database(f"sqlite:///{tmp_path / 'wayloom.db'}")
    upgrade(found)
    yield found
    found.close()


def test_an_entry_that_is_waited_for_is_committed_and_alike_ones_that_are_not_are_one_row(database: Database) -> None:
    async def work() -> None:
        trail = Trail(database)
        for k in range(1000):
            trail.gather(replace(ENTRY, at=float(k)))
        changed = Noted(5.0, "user anna", "admin", "POST /v1/keys", "", "10.0.0.1", 201, "done")
        await asyncio.gather(*(trail.add(changed) for _ in range(3)))
        with database.read() as session:
            rows = [(row.at, row.actor, row.count) for row in page(session, 9)]
        assert rows == [(5.0, "user anna", 1)] * 3 + [(0.0, "nobody", 1000)]
        trail.gather(ENTRY)
        await trail.close()

    asyncio.run(work())
    with database.read() as session:
        assert len(page(session, 9)) == 5


def test_an_answer_goes_out_though_the_audit_log_cannot_be_written_and_the_entry_is_in_the_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = Database(f"sqlite:///{tmp_path / 'empty.db'}")  # without its tables
    asyncio.run(asyncio.wait_for(Trail(empty).add(ENTRY), 20.0))
    empty.close()
    assert "not in the audit log" in capsys.readouterr().out


def test_a_public_address_wants_a_key_or_that_access_is_asked_for() -> None:
    for settings in ({}, {"access": {"required": False}}):
        with pytest.raises(ConfigError, match="no API key is set"):
            ServiceSettings.model_validate({"host": "0.0.0.0", **settings}).check_exposure()
    for settings in ({"api_key": API_KEY}, {"access": {"required": True}}):
        ServiceSettings.model_validate({"host": "0.0.0.0", **settings}).check_exposure()


def test_a_service_may_ask_for_keys_without_one_in_its_settings(tmp_path: Path) -> None:
    with closing(Guarded(tmp_path / "data", WAYLOOM_API_KEY="", WAYLOOM_ACCESS__REQUIRED="true")) as service:
        assert service.http.get("/v1/info").json()["needs_key"] is True
        assert service.http.get("/v1/drives").status_code == 401
        assert service.http.get("/v1/drives", headers=bearer(service.key(Role.VIEWER))).status_code == 200


def test_what_the_database_said_before_a_revocation_is_not_held_after_it(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A look-up that is under way while this process revokes the key."""
    with database.write() as session:
        row, text = keys.create(session, "x", Role.VIEWER)
        keys.note_use(session, row.id)
    callers, given = Callers(database, ServiceSettings(api_key=API_KEY)), Credential(text, False)
    found = keys.find

    def slow(session: Session, key: str) -> keys.KnownKey | None:
        known = found(session, key)
        callers.forget()
        return known

    assert callers.find(given) == callers.held(given)
    callers.forget()
    assert callers.held(given) is None
    monkeypatch.setattr(keys, "find", slow)
    assert callers.find(given).role is Role.VIEWER
    assert callers.held(given) is None
