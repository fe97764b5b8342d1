"""The operators' sign-in by an OpenID provider: the whole way, and all ways in which it must end without a session."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx2
import pytest
from joserfc.jwk import ECKey, OctKey, RSAKey

from service_kit.browsers import chromium
from service_kit.guarded import API_KEY, PASSWORD, Guarded, bearer
from service_kit.openid_provider import CLIENT_ID, CLIENT_SECRET, NOT_ANSWERED, OpenIdProvider, openid_provider
from service_kit.running import until
from wayloom.store.access import users

START, CALLBACK = "/v1/session/oidc", "/v1/session/oidc/callback"
HTTPS = {"X-Forwarded-Proto": "https"}
ROLES = "map-admins=admin,map-operators=operator,map-readers=viewer"


@pytest.fixture(scope="module")
def at_start() -> Iterator[OpenIdProvider]:
    with openid_provider() as running:
        yield running


@pytest.fixture
def provider(at_start: OpenIdProvider) -> Iterator[OpenIdProvider]:
    at_start.changed = {"groups": ["map-operators"]}
    yield at_start
    at_start.reset()


@pytest.fixture(scope="module")
def service(at_start: OpenIdProvider, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    folder = tmp_path_factory.mktemp("guarded")
    (folder / "secret").write_text(CLIENT_SECRET + "\n")
    guarded = Guarded(folder / "data", **variables(at_start, folder / "secret"))
    yield guarded
    guarded.close()


@pytest.fixture
def browser(service: Guarded) -> Iterator[httpx2.Client]:
    with another(service) as client:
        yield client


def variables(provider: OpenIdProvider, secret: Path) -> dict[str, str]:
    named = {
        "ISSUER": provider.issuer, "CLIENT_ID": CLIENT_ID, "CLIENT_SECRET_FILE": str(secret), "ROLE_CLAIM": "groups",
        "ROLES": ROLES, "LABEL": "Sign in with the fleet's account", "TIMEOUT_S": "2",
    }  # fmt: skip
    return {f"WAYLOOM_ACCESS__OIDC_{name}": text for name, text in named.items()}


def another(service: Guarded) -> httpx2.Client:
    """A browser at an address of its own: the tries of one are counted."""
    another.count = getattr(another, "count", 0) + 1  # type: ignore[attr-defined]
    client = service.browser()
    client.headers.update({"X-Forwarded-For": f"10.9.{another.count // 250}.{another.count % 250}"})  # type: ignore[attr-defined]
    return client


def at_provider(browser: httpx2.Client, wanted: str | None = None) -> str:
    """Begin a sign-in, and let the provider sign in. Returns the address to which it leads back."""
    begun = browser.get(START, params={} if wanted is None else {"next": wanted})
    assert begun.status_code == 303, begun.text
    with httpx2.Client(trust_env=False) as http:
        answer = http.get(begun.headers["Location"])
    assert answer.status_code == 302, answer.text
    return str(answer.headers["Location"])


def signed_in(browser: httpx2.Client, wanted: str | None = None) -> httpx2.Response:
    return browser.get(at_provider(browser, wanted))


def check_refused(browser: httpx2.Client, answer: httpx2.Response, code: str, status: int = 403) -> None:
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert "wayloom" not in browser.cookies
    assert browser.get("/v1/drives").status_code == 401


def audit(service: Guarded, **query: Any) -> list[dict[str, Any]]:
    found = service.http.get("/v1/audit", params={"limit": 500, **query}, headers=bearer(API_KEY)).json()["entries"]
    return [one for one in found if one["action"] == f"GET {CALLBACK}"]


def test_the_provider_signs_in_and_the_session_is_one_like_any_other(
    service: Guarded, provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    answer = signed_in(browser, "/drives/abc")
    assert (answer.status_code, answer.headers["Location"]) == (303, "/drives/abc")
    (cookie,) = [text for text in answer.headers.get_list("Set-Cookie") if text.startswith("wayloom=")]
    assert {"HttpOnly", "SameSite=strict", "Path=/", "Max-Age=43200"} <= set(cookie.split("; "))
    assert "wayloom-oidc" not in browser.cookies
    me = browser.get("/v1/session").json()
    assert (me["role"], me["signed_in"]) == ("operator", True)
    assert me["name"].startswith("user anna.b-")
    change = f"/v1/drives/{'e' * 64}/cancel"
    assert browser.post(change).status_code == 404
    assert browser.post(change, headers={"X-Requested-With": ""}).json()["code"] == "cross-site"
    assert browser.get("/v1/audit").status_code == 403
    (entry,) = audit(service, outcome="done")[:1]
    assert (entry["object"], entry["status"]) == (me["name"], 303)
    token = browser.cookies["wayloom"]
    assert browser.delete("/v1/session").status_code == 204
    assert browser.get("/v1/drives", headers={"Cookie": f"wayloom={token}"}).status_code == 401


def test_the_way_to_the_provider_has_state_nonce_and_a_challenge_and_shows_no_secret(
    provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    begun = [browser.get(START) for _ in range(2)]
    asked = [parse_qs(urlsplit(one.headers["Location"]).query) for one in begun]
    assert {"state", "nonce", "code_challenge", "redirect_uri", "scope"} <= asked[0].keys()
    assert (asked[0]["code_challenge_method"], asked[0]["response_type"]) == (["S256"], ["code"])
    assert all(asked[0][name] != asked[1][name] for name in ("state", "nonce", "code_challenge"))
    assert CLIENT_SECRET not in begun[0].headers["Location"]
    assert {"HttpOnly", "SameSite=lax"} <= set(begun[0].headers["Set-Cookie"].split("; "))


def test_over_https_both_cookies_are_secure_and_of_this_host_alone(provider: OpenIdProvider, browser: httpx2.Client) -> None:
    begun = browser.get(START, headers=HTTPS)
    name, _, text = begun.headers["Set-Cookie"].partition(";")[0].partition("=")
    assert name == "__Host-wayloom-oidc"
    assert "Secure" in begun.headers["Set-Cookie"].split("; ")
    with httpx2.Client(trust_env=False) as http:
        back = http.get(begun.headers["Location"]).headers["Location"]
    assert back.startswith("https://")
    answer = browser.get(back.replace("https:", "http:"), headers=HTTPS | {"Cookie": f"{name}={text}"})
    (cookie,) = [text for text in answer.headers.get_list("Set-Cookie") if text.startswith("__Host-wayloom=")]
    assert {"Secure", "HttpOnly", "SameSite=strict"} <= set(cookie.split("; "))


@pytest.mark.parametrize(
    "wanted",
    [
        "//evil.example",
        "https://evil.example/",
        "/\\evil.example",
        "\\\\evil.example",
        "/\t/evil.example",
        "drives",
        "javascript:0",
    ],
)
def test_the_way_back_leads_to_pages_of_this_service_alone(provider: OpenIdProvider, browser: httpx2.Client, wanted: str) -> None:
    answer = signed_in(browser, wanted)
    assert (answer.status_code, answer.headers["Location"]) == (303, "/")


NOW = int(time.time())


@pytest.mark.parametrize(
    "changed",
    [
        {"nonce": "of another sign-in"}, {"nonce": NOT_ANSWERED}, {"exp": NOW - 3600, "iat": NOW - 7200}, {"exp": NOT_ANSWERED},
        {"aud": "another client"}, {"aud": NOT_ANSWERED}, {"aud": [CLIENT_ID, "another"], "azp": "another"},
        {"iss": "https://evil.example"}, {"iss": NOT_ANSWERED}, {"sub": NOT_ANSWERED}, {"sub": ""}, {"sub": 5}, {"exp": "never"},
        {"nbf": NOW + 3600}, {"at_hash": "of another token"},
    ],
    ids=[
        "another nonce", "no nonce", "expired", "never expires", "another audience", "no audience", "another party",
        "another issuer", "no issuer", "no subject", "an empty subject", "a numeric subject", "a wordy expiry", "not yet",
        "another access token",
    ],
)  # fmt: skip
def test_a_token_that_is_not_for_this_sign_in_begins_no_session(
    provider: OpenIdProvider, browser: httpx2.Client, changed: dict[str, Any]
) -> None:
    provider.changed |= changed
    check_refused(browser, signed_in(browser), "wrong-token")


@pytest.mark.parametrize("how", ["none", "by the client's secret", "by another key", "by another key of the same name", "RS384"])
def test_a_token_that_the_provider_did_not_sign_by_its_key_begins_no_session(
    provider: OpenIdProvider, browser: httpx2.Client, how: str
) -> None:
    if how == "none":
        provider.algorithm = "none"
    elif how == "by the client's secret":
        provider.signer, provider.algorithm = OctKey.import_key(CLIENT_SECRET), "HS256"
    elif how == "RS384":
        provider.algorithm = how
    else:
        provider.signer = RSAKey.generate_key(2048, {"kid": "first" if "name" in how else "unknown"})
    check_refused(browser, signed_in(browser), "wrong-token")


def test_a_new_key_of_the_provider_is_taken_at_once_also_one_of_elliptic_curves(
    provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    assert signed_in(browser).status_code == 303
    provider.keys.append(ECKey.generate_key("P-256", {"kid": "second"}))
    provider.algorithm = "ES256"
    try:
        assert signed_in(browser).status_code == 303
    finally:
        provider.keys.pop()


def test_a_state_that_is_not_this_browsers_begins_no_session(
    service: Guarded, provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    back = at_provider(browser)
    with another(service) as victim:  # is led to the end of somebody else's sign-in
        check_refused(victim, victim.get(back), "wrong-state")
        at_provider(victim)
        check_refused(victim, victim.get(back), "wrong-state")
    forged = browser.get(f"{CALLBACK}?code=x&state=x", headers={"Cookie": "wayloom-oidc=e30.e30.e30"})
    check_refused(browser, forged, "wrong-state")
    check_refused(browser, browser.get(f"{CALLBACK}?code=x"), "wrong-state")
    assert until(lambda: [one for one in audit(service, outcome="refused") if one["status"] == 403])


def test_a_sign_in_that_is_over_begins_no_second_session(
    service: Guarded, provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    back = at_provider(browser)
    kept = browser.cookies["wayloom-oidc"]
    assert browser.get(back).status_code == 303
    with another(service) as thief:
        check_refused(thief, thief.get(back), "wrong-state")
        check_refused(thief, thief.get(back, headers={"Cookie": f"wayloom-oidc={kept}"}), "wrong-code")


def test_an_answer_of_another_issuer_and_a_denial_begin_no_session(provider: OpenIdProvider, browser: httpx2.Client) -> None:
    back = at_provider(browser)
    check_refused(browser, browser.get(back.replace("localhost%3A", "evil.example%3A")), "wrong-issuer")
    provider.denies = True
    answer = signed_in(browser)
    assert "access_denied" in answer.text
    check_refused(browser, answer, "refused-by-provider")


def test_a_provider_that_is_away_is_said_and_found_again_when_it_is_back(
    provider: OpenIdProvider, at_start: OpenIdProvider, tmp_path: Path
) -> None:
    (tmp_path / "secret").write_text(CLIENT_SECRET)
    service = Guarded(tmp_path / "data", **variables(provider, tmp_path / "secret"))
    try:
        with another(service) as browser:
            provider.is_away = True
            answer = browser.get(START)
            assert "Traceback" not in answer.text
            assert answer.headers["Retry-After"] == "5"
            check_refused(browser, answer, "away", 503)
            provider.is_away = False
            back = at_provider(browser)
            provider.is_away = True
            check_refused(browser, browser.get(back), "away", 503)
            provider.is_away = False
            assert signed_in(browser).status_code == 303
    finally:
        service.close()


@pytest.mark.parametrize(
    ("groups", "role"),
    [
        (["map-readers"], "viewer"), ("map-readers", "viewer"), (["map-readers", "map-admins", "x"], "admin"),
        (["x"], None), ([], None), (NOT_ANSWERED, None), ([{"map-admins": 1}, 5], None), ("map-admins map-readers", None),
    ],
)  # fmt: skip
def test_the_claim_gives_the_role_and_without_one_nobody_comes_in(
    provider: OpenIdProvider, browser: httpx2.Client, groups: object, role: str | None
) -> None:
    provider.user = {"sub": f"of {groups!r}"[:80], "preferred_username": "some body"}
    provider.changed = {"groups": groups}
    answer = signed_in(browser)
    if role is None:
        check_refused(browser, answer, "forbidden")
        return
    assert answer.status_code == 303
    assert browser.get("/v1/session").json()["role"] == role


def test_a_role_is_renewed_with_each_sign_in_and_its_end_ends_the_sessions(
    service: Guarded, provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    assert signed_in(browser).status_code == 303
    name = browser.get("/v1/session").json()["name"]
    with another(service) as elsewhere:
        provider.changed = {"groups": ["map-readers"], "preferred_username": "married since"}
        assert signed_in(elsewhere).status_code == 303
        assert elsewhere.get("/v1/session").json() | {"rights": []} == {
            "name": name,
            "role": "viewer",
            "rights": [],
            "signed_in": True,
        }
        assert browser.get("/v1/session").json()["role"] == "viewer"
        provider.changed = {"groups": []}
        assert signed_in(elsewhere).status_code == 403
        assert [one.get("/v1/session").status_code for one in (browser, elsewhere)] == [401, 401]


def test_a_user_of_a_password_and_one_of_the_provider_are_two_whatever_they_are_called(
    service: Guarded, provider: OpenIdProvider, browser: httpx2.Client
) -> None:
    with service.database.write() as session:
        users.add(session, "carol", users.Role.ADMIN, PASSWORD)
    provider.user = {"sub": "c", "preferred_username": "carol"}
    assert signed_in(browser).status_code == 303
    me = browser.get("/v1/session").json()
    assert (me["name"].startswith("user carol-"), me["role"]) == (True, "operator")
    with another(service) as other:
        assert service.sign_in(other, me["name"].removeprefix("user "), PASSWORD).status_code == 401


def test_a_user_who_is_disabled_stays_out_until_enabled(service: Guarded, provider: OpenIdProvider, browser: httpx2.Client) -> None:
    provider.user = {"sub": "d", "preferred_username": "dora"}
    assert signed_in(browser).status_code == 303
    name = browser.get("/v1/session").json()["name"].removeprefix("user ")
    with service.database.write() as session:
        users.disable(session, name)
    until(lambda: browser.get("/v1/drives").status_code == 401, 25)
    browser.cookies.clear()
    refused = signed_in(browser)
    assert "disabled" in refused.text
    check_refused(browser, refused, "forbidden")
    assert until(lambda: [one for one in audit(service, outcome="refused") if one["object"] == f"user {name}"])
    with service.database.write() as session:
        users.enable(session, name)
    assert signed_in(browser).status_code == 303


def test_a_provider_that_wants_the_secret_in_the_form_gets_it_there(provider: OpenIdProvider, tmp_path: Path) -> None:
    provider.auth_methods = ["client_secret_post"]
    (tmp_path / "secret").write_text(CLIENT_SECRET)
    service = Guarded(tmp_path / "data", **variables(provider, tmp_path / "secret"))
    try:
        with another(service) as browser:
            assert signed_in(browser).status_code == 303
    finally:
        service.close()


def test_one_address_begins_no_more_than_some_sign_ins(provider: OpenIdProvider, browser: httpx2.Client) -> None:
    answers = [browser.get(START) for _ in range(16)]
    assert {answer.status_code for answer in answers} == {303, 429}
    assert answers[-1].headers["Retry-After"]


def test_a_service_without_a_provider_has_neither_routes_nor_a_button(tmp_path: Path) -> None:
    service = Guarded(tmp_path / "data")
    try:
        for path in (START, CALLBACK, f"{START}?next=/", f"{CALLBACK}?code=x&state=y"):
            assert (service.http.get(path).status_code, service.http.get(path).json()["code"]) == (404, "not-found")
        assert service.http.get("/v1/info").json()["oidc_label"] is None
    finally:
        service.close()


@pytest.mark.browser
def test_in_a_browser_the_button_leads_to_the_provider_and_back_to_the_page(service: Guarded, provider: OpenIdProvider) -> None:
    with chromium() as launched:
        page = launched.new_page()
        complaints: list[str] = []
        page.on("console", lambda message: complaints.append(message.text) if "Content Security" in message.text else None)
        page.goto(f"{service.api.url}/")
        page.wait_for_selector("#oidc-link:visible")
        assert page.inner_text("#oidc-link") == "Sign in with the fleet's account"
        page.click("#oidc-link")
        page.click("#continue")  # on the provider's own site
        page.wait_for_selector("#who")
        assert page.inner_text("#who").startswith("anna.b-")
        assert page.url == f"{service.api.url}/"
        page.click("#sign-out")
        page.wait_for_selector("#oidc-link:visible")
        provider.changed = {"groups": []}
        page.click("#oidc-link")
        page.click("#continue")
        assert "no role" in page.inner_text("#problem")
        assert complaints == []
