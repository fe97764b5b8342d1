"""What admins and operators do on the pages of areas and of access, and what the pages keep from others."""

import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

from service_kit.browsers import answering
from service_kit.filled_service import change
from service_kit.guarded import API_KEY, PASSWORD, Guarded, bearer
from service_kit.running import until
from wayloom.config.roles import Role

USERS = {"anna": Role.ADMIN, "otto": Role.OPERATOR, "vera": Role.VIEWER}
YARD = {"type": "Polygon", "coordinates": [[[8.40, 49.01], [8.41, 49.01], [8.41, 49.02], [8.40, 49.01]]]}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    service = Guarded(tmp_path_factory.mktemp("guarded") / "data")
    for name, role in USERS.items():
        service.user(name, role)
    with closing(service):
        answering(service.api.url)
        yield service


def page_of(browser: Any, guarded: Guarded, name: str, path: str) -> Any:
    """A page as a user sees it, signed in."""
    page = browser.new_context().new_page()
    page.goto(f"{guarded.api.url}{path}")
    page.wait_for_url("**/sign-in?next=*")
    page.fill("#name", name)
    page.fill("#password", PASSWORD)
    page.click("#sign-in button")
    page.wait_for_url(f"**{path}")
    return page


def keys_of(page: Any) -> list[str]:
    return [row.replace("\t", " ") for row in page.locator("#keys tbody tr").all_inner_texts()]


@pytest.mark.browser
def test_an_operator_excludes_an_area_and_takes_it_back(browser: Any, guarded: Guarded) -> None:
    with closing(page_of(browser, guarded, "otto", "/areas")) as page:
        until(lambda: "No area is excluded" in page.inner_text("#areas"))
        page.fill("#area-name", "the yard")
        page.fill("#geojson", json.dumps(YARD))
        page.click("#add-form button")
        page.wait_for_selector("#areas tbody tr")
        assert "the yard" in page.inner_text("#areas tbody tr")
        assert page.input_value("#geojson") == ""
        page.click("#areas tbody button")
        page.keyboard.press("Escape")
        page.wait_for_selector("dialog", state="detached")
        assert page.locator("#areas tbody tr").count() == 1  # nothing goes before it was said twice
        page.click("#areas tbody button")
        page.click("dialog .danger")
        until(lambda: "No area is excluded" in page.inner_text("#areas"))


@pytest.mark.browser
@pytest.mark.parametrize("text", ["no JSON", '{"type": "Point", "coordinates": [8.4, 49.0]}'])
def test_an_area_that_is_none_is_refused_and_the_text_stays(browser: Any, guarded: Guarded, text: str) -> None:
    with closing(page_of(browser, guarded, "otto", "/areas")) as page:
        page.fill("#geojson", text)
        page.click("#add-form button")
        until(lambda: page.is_visible("#problem") and len(page.inner_text("#problem")) > 10)
        assert page.input_value("#geojson") == text


@pytest.mark.browser
def test_an_area_comes_from_a_file_too(browser: Any, guarded: Guarded, tmp_path: Any) -> None:
    file = tmp_path / "areas.geojson"
    named = [{"type": "Feature", "properties": {"name": name}, "geometry": YARD} for name in ("depot", "gate")]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": named}))
    with closing(page_of(browser, guarded, "anna", "/areas")) as page:
        page.wait_for_selector("#add")
        page.set_input_files("#file", str(file))
        until(lambda: "depot" in page.input_value("#geojson"))
        page.click("#add-form button")
        until(lambda: page.locator("#areas tbody tr").count() == 2)
        for _ in named:
            left = page.locator("#areas tbody tr").count()
            page.click("#areas tbody button >> nth=0")
            page.click("dialog .danger")
            until(lambda left=left: page.locator("#areas tbody tr").count() < left)


@pytest.mark.browser
def test_viewers_see_areas_and_change_none_and_keys_are_for_admins(browser: Any, guarded: Guarded) -> None:
    with closing(page_of(browser, guarded, "vera", "/areas")) as page:
        page.wait_for_selector("#areas p, #areas table")
        assert not page.is_visible("#add")
        page.goto(f"{guarded.api.url}/access")
        until(lambda: "admins alone" in page.inner_text("#problem"))
        assert page.inner_text("#keys") == ""


@pytest.mark.browser
def test_an_admin_makes_a_key_renews_and_revokes_it_and_the_audit_log_tells(browser: Any, guarded: Guarded) -> None:
    def role_of(key: str) -> object:
        answer = guarded.http.get("/v1/session", headers=bearer(key))
        return answer.json().get("role") if answer.status_code == 200 else answer.status_code

    with closing(page_of(browser, guarded, "anna", "/access")) as page:
        page.click("#new-key")
        assert page.is_disabled("dialog .primary")  # no name yet
        page.fill("dialog input[name=name]", "the tiles' cache")
        page.select_option("dialog select[name=role]", "viewer")
        page.fill("dialog input[name=days]", "7")
        page.click("dialog .primary")
        until(lambda: page.is_visible("#made code"))
        first = page.inner_text("#made code")
        assert role_of(first) == "viewer"
        row = page.locator("#keys tbody tr", has_text="the tiles' cache")
        until(lambda: row.count() == 1)
        assert "valid until" in row.inner_text()
        row.locator("button:text('New secret')").click()
        page.click("dialog .primary")
        until(lambda: page.inner_text("#made code") != first)
        second = page.inner_text("#made code")
        assert role_of(second) == "viewer"
        row.locator("button:text('Revoke')").last.click()
        page.click("dialog .danger")
        until(lambda: any("revoked" in one for one in keys_of(page)))
        until(lambda: role_of(second) == 401)  # who has been let in is held for some seconds
        page.reload()
        page.wait_for_selector("#audit tbody tr")
        page.fill("#actor", "user anna")
        page.select_option("#outcome", "done")
        page.click("#audit-filter button")
        until(lambda: all("user anna" in one for one in page.locator("#audit tbody tr").all_inner_texts()))
        assert "DELETE" in page.inner_text("#audit") or "revoke" in page.inner_text("#audit")
        assert second not in page.content()


@pytest.mark.browser
def test_a_key_of_a_vehicle_sends_drives_of_that_vehicle_alone(browser: Any, guarded: Guarded) -> None:
    with closing(page_of(browser, guarded, "anna", "/access")) as page:
        page.click("#new-key")
        page.fill("dialog input[name=name]", "van nine")
        page.fill("dialog input[name=vehicle]", "van-9")
        page.click("dialog .primary")
        until(lambda: page.is_visible("#made code"))
        key = page.inner_text("#made code")
        until(lambda: any("van-9" in one for one in keys_of(page)))
    assert guarded.announce(key, vehicle_id="van-9").status_code == 201
    assert guarded.announce(key, vehicle_id="van-8").status_code == 403


@pytest.mark.browser
def test_a_viewer_is_told_who_may_do_something_about_a_held_drive(browser: Any, guarded: Guarded) -> None:
    drive = guarded.drive(API_KEY)
    change(guarded.api, drive, state="held", grade="D", gate="hold", reasons=["sigma 2.00 m"], placed=True)
    with closing(page_of(browser, guarded, "vera", f"/drives/{drive}")) as page:
        page.wait_for_selector("#ways-out li")
        assert page.inner_text("#ways-out") == (
            "An operator may release it into the map, process it anew with other settings or delete it. You may look at it."
        )
        assert not page.is_visible("#ask-release")
