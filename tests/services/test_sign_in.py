"""The operators' sign-in: sessions by cookie, wrong passwords, and what pages of others can make a browser do."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx2
import pytest

from service_kit import postgres
from service_kit.guarded import API_KEY, FROM_PAGE, PASSWORD, Guarded, bearer
from service_kit.running import until
from wayloom.config.roles import Role
from wayloom.store.access import users

HTTPS = {"X-Forwarded-Proto": "https"}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    guarded = Guarded(tmp_path_factory.mktemp("guarded") / "data", WAYLOOM_ACCESS__SESSION_S="3600")
    for role in (Role.VIEWER, Role.OPERATOR, Role.ADMIN):
        guarded.user(role, role)
    yield guarded
    guarded.close()


@pytest.fixture
def browser(service: Guarded) -> Iterator[httpx2.Client]:
    with service.browser() as client:
        yield client


def elsewhere(address: str) -> dict[str, str]:
    """As from another address: the tries of one are counted."""
    return {"X-Forwarded-For": address}


def signed_in(service: Guarded, browser: httpx2.Client, name: str, address: str) -> httpx2.Response:
    browser.headers.update(elsewhere(address))
    answer = service.sign_in(browser, name)
    assert answer.status_code == 200, answer.text
    return answer


def test_a_session_lasts_until_its_end_or_a_sign_out_and_no_script_reads_its_cookie(
    service: Guarded, browser: httpx2.Client
) -> None:
    assert browser.get("/v1/session").status_code == 401
    answer = signed_in(service, browser, "operator", "10.1.0.1")
    assert answer.json() == {
        "name": "user operator", "role": "operator", "rights": ["follow", "operate", "read", "send"], "signed_in": True,
    }  # fmt: skip
    cookie = answer.headers["Set-Cookie"]
    assert {"HttpOnly", "SameSite=strict", "Path=/", "Max-Age=3600"} <= set(cookie.split("; "))
    assert "Secure" not in cookie
    assert browser.get("/v1/drives").status_code == 200
    assert browser.get("/v1/maps/city/tiles/semantic/0/0/0.png").status_code == 404  # no map yet
    assert browser.get("/v1/audit").status_code == 403
    token = browser.cookies["wayloom"]
    assert browser.delete("/v1/session").status_code == 204
    assert "wayloom" not in browser.cookies
    for again in (None, token):
        cookies = {} if again is None else {"Cookie": f"wayloom={again}"}
        assert browser.get("/v1/drives", headers=cookies).status_code == 401


def test_over_https_the_cookie_is_secure_and_of_this_host_alone(service: Guarded, browser: httpx2.Client) -> None:
    browser.headers.update(elsewhere("10.1.0.2"))
    answer = browser.post("/v1/session", json={"name": "viewer", "password": PASSWORD}, headers=HTTPS)
    name, _, token = answer.headers["Set-Cookie"].partition(";")[0].partition("=")
    assert name == "__Host-wayloom"
    assert {"Secure", "HttpOnly", "SameSite=strict", "Path=/"} <= set(answer.headers["Set-Cookie"].split("; "))
    assert "Domain" not in answer.headers["Set-Cookie"]
    assert browser.get("/v1/drives", headers=HTTPS | {"Cookie": f"__Host-wayloom={token}"}).status_code == 200
    # a cookie of the other name, which http can set for https too, is nobody's there
    assert browser.get("/v1/drives", headers=HTTPS | {"Cookie": f"wayloom={token}"}).status_code == 401


def test_a_sign_in_takes_no_token_that_the_browser_brought_along(service: Guarded, browser: httpx2.Client) -> None:
    """Session fixation: a token that somebody else knows is not the one of the session, and an older session ends."""
    signed_in(service, browser, "viewer", "10.1.0.3")
    first = browser.cookies["wayloom"]
    for brought in ("chosen-by-somebody-else-chosen-by-somebody", first):
        with service.browser() as other:
            other.headers.update(elsewhere("10.1.0.3"))
            other.headers["Cookie"] = f"wayloom={brought}"
            answer = service.sign_in(other, "viewer")
            assert answer.status_code == 200
            assert brought not in answer.headers["Set-Cookie"]
            assert other.get("/v1/drives").status_code == 401
    assert browser.get("/v1/drives").status_code == 401


CHANGE = f"/v1/drives/{'e' * 64}/cancel"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 404), ({"Origin": "own"}, 404), ({"X-Requested-With": ""}, 403), ({"X-Requested-With": "XMLHttpRequest"}, 403),
        ({"Origin": "https://evil.example"}, 403), ({"Origin": "null"}, 403), ({"Origin": "http://127.0.0.1:1"}, 403),
        ({"Origin": "own", "X-Requested-With": ""}, 403), ({"Authorization": "", "X-Requested-With": ""}, 403),
    ],
)  # fmt: skip
def test_a_cookie_changes_nothing_for_a_page_of_another_origin(
    service: Guarded, browser: httpx2.Client, headers: dict[str, str], status: int
) -> None:
    signed_in(service, browser, "operator", f"10.2.0.{len(str(headers))}")
    sent = {name: service.api.url if value == "own" else value for name, value in headers.items()}
    answer = browser.post(CHANGE, headers=sent)
    assert (answer.status_code, answer.json()["code"]) == (status, "cross-site" if status == 403 else "not-found")
    # what such a page must not do to somebody who is not signed in: sign them in as somebody else
    assert (browser.post("/v1/session", json={}, headers=sent).status_code == 403) == (status == 403)


def test_a_key_needs_no_header_of_a_page_and_stands_above_a_cookie(service: Guarded, browser: httpx2.Client) -> None:
    signed_in(service, browser, "viewer", "10.1.0.4")
    key = service.key(Role.OPERATOR)
    assert service.http.post(CHANGE, headers=bearer(key)).status_code == 404
    assert browser.post(CHANGE).status_code == 403
    assert browser.post(CHANGE, headers=bearer(key)).status_code == 404
    assert browser.get("/v1/drives", headers=bearer("wlk_no_key")).status_code == 401  # a bad key is not made good by a cookie


def test_name_and_password_are_not_told_apart_and_wrong_ones_are_written_down(service: Guarded, browser: httpx2.Client) -> None:
    browser.headers.update(elsewhere("10.1.0.5"))
    answers = [
        service.sign_in(browser, name, password) for name, password in (("viewer", "not the password"), ("nobody", PASSWORD))
    ]
    assert [answer.status_code for answer in answers] == [401, 401]
    assert answers[0].text == answers[1].text
    assert "Set-Cookie" not in answers[0].headers
    query = {"outcome": "refused", "limit": 500}

    def noted() -> list[str]:
        entries = service.http.get("/v1/audit", params=query, headers=bearer(API_KEY)).json()["entries"]
        return [one["object"] for one in entries if one["action"] == "POST /v1/session" and one["address"] == "10.1.0.5"]

    assert until(lambda: sorted(noted()) == ["", "user viewer"])  # a name that is no user's may be a password


def test_after_some_wrong_passwords_the_right_one_has_to_wait_too(service: Guarded, browser: httpx2.Client) -> None:
    service.user("guessed", Role.VIEWER)
    answers = []
    for k in range(users.FREE_FAILURES + 2):
        browser.headers.update(elsewhere(f"10.3.0.{k}"))  # from as many addresses as one likes
        answers.append(service.sign_in(browser, "guessed", "not the password"))
    answers += [service.sign_in(browser, "guessed"), service.sign_in(browser, "nobody")]
    assert {(answer.status_code, answer.text) for answer in answers} == {(401, answers[-1].text)}  # nobody learns who is a user
    assert service.sign_in(browser, "viewer").status_code == 200
    until(lambda: service.sign_in(browser, "guessed").status_code == 200, 20)


def test_one_address_tries_no_more_than_some_passwords(service: Guarded, browser: httpx2.Client) -> None:
    browser.headers.update(elsewhere("10.4.0.1"))
    answers = [service.sign_in(browser, f"user-{k}", "not the password") for k in range(10)]
    while answers[-1].status_code == 401 and len(answers) < 60:  # some seconds give one more
        answers.append(service.sign_in(browser, "user", "not the password"))
    assert [answer.status_code for answer in answers] == [401] * (len(answers) - 1) + [429]
    assert 1 <= int(answers[-1].headers["Retry-After"]) <= 6


@pytest.mark.parametrize(
    "body", [{"name": "viewer"}, {"name": "v" * 65, "password": "x"}, {"name": "viewer", "password": "x" * 300}, []]
)
def test_what_is_no_sign_in_is_malformed(service: Guarded, browser: httpx2.Client, body: object) -> None:
    assert browser.post("/v1/session", json=body).status_code == 422
    assert service.http.post("/v1/session", content=b"x" * 5000, headers=FROM_PAGE).status_code == 413


def test_another_password_and_the_users_end_end_sessions(service: Guarded, browser: httpx2.Client) -> None:
    service.user("leaving", Role.VIEWER)
    signed_in(service, browser, "leaving", "10.1.0.6")
    with service.database.write() as session:
        users.remove(session, "leaving")
    until(lambda: browser.get("/v1/drives").status_code == 401, 25)


@pytest.mark.postgres
def test_on_postgresql_keys_owners_quotas_sign_ins_and_the_audit_log_work_as_on_sqlite(tmp_path: Path) -> None:
    with postgres.cluster() as folder:
        variables = {"WAYLOOM_DATABASE_URL": postgres.new_database(folder), "WAYLOOM_ACCESS__DRIVES_A_DAY": "2"}
        with closing(Guarded(tmp_path / "data", **variables)) as service, service.browser() as browser:
            ours, theirs = service.key(Role.VEHICLE, "van-1"), service.key(Role.VEHICLE, "van-2")
            drive = service.drive(ours)
            seen = [service.http.get(f"/v1/drives/{drive}", headers=bearer(key)).status_code for key in (ours, theirs, None)]
            assert seen == [200, 404, 401]
            assert [service.announce(ours).status_code for _ in range(2)] == [201, 429]
            service.user("anna", Role.ADMIN)
            assert [service.sign_in(browser, "anna", one).status_code for one in ("not the password", PASSWORD)] == [401, 200]
            made = browser.post("/v1/keys", json={"name": "x", "role": "viewer"}).json()
            assert service.http.get("/v1/maps", headers=bearer(made["key"])).status_code == 200
            assert browser.delete(f"/v1/keys/{made['prefix']}").status_code == 200
            assert service.http.get("/v1/maps", headers=bearer(made["key"])).status_code == 401
            entries = browser.get("/v1/audit", params={"actor": "user anna"}).json()["entries"]
            assert [one["action"] for one in entries] == ["DELETE /v1/keys/{prefix}", "POST /v1/keys"]
