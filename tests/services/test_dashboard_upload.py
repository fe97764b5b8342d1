"""A drive sent from the page: chosen or dropped, hashed, sent resumably; it goes on after a pause and after a reload."""

import hashlib
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from service_kit.browsers import answering, watched
from service_kit.running import ApiAlone, service, until
from wayloom.client.watch import wait_for_drive
from wayloom.store.database import Database
from wayloom.store.drives import get

LARGE = 40 * 2**20


def folder(root: Path, sizes: tuple[int, ...]) -> Path:
    """A drive's folder with files of these sizes, something of the finder's among them."""
    log = root / "street 7"
    (log / "image_0").mkdir(parents=True)
    for number, size in enumerate(sizes):
        (log / "image_0" / f"{number:06}.png").write_bytes(np.random.default_rng(number).bytes(size))
    (log / "play.json").write_text("{}")
    (log / ".DS_Store").write_bytes(b"junk")
    return log


def choose(page: Any, log: Path) -> None:
    page.wait_for_selector("#send button")
    page.set_input_files("#choose-folder", str(log))
    page.wait_for_selector("dialog")


@pytest.mark.browser
def test_a_chosen_folder_is_sent_whole_named_and_mapped(browser: Any, tmp_path: Path) -> None:
    log = folder(tmp_path, (1000, 0, 700_000))
    with service(tmp_path / "data") as up, watched(browser, up.url) as page:
        choose(page, log)
        assert "4 files" in page.inner_text("dialog")  # the finder's is not sent
        assert page.input_value("dialog input[name=name]") == "street 7"
        page.fill("dialog input[name=name]", "street seven")
        page.fill("dialog input[name=vehicle]", "van-7")
        page.click("dialog .primary")
        until(lambda: "sent, it is being processed" in page.inner_text(".upload .words"))
        (drive,) = up.api().json("GET", "/v1/drives")["drives"]
        assert (drive["name"], drive["vehicle_id"], drive["files"]) == ("street seven", "van-7", 4)
        assert wait_for_drive(up.api(), drive["id"])["state"] == "done"
        stored = up.data / "drives" / drive["id"] / "log" / "image_0" / "000002.png"
        assert stored.read_bytes() == (log / "image_0" / "000002.png").read_bytes()


@pytest.mark.browser
def test_a_large_file_is_hashed_in_pieces_paused_and_goes_on_after_a_reload(browser: Any, tmp_path: Path) -> None:
    log = folder(tmp_path, (LARGE,))
    with closing(ApiAlone(tmp_path / "data")) as alone:
        answering(alone.url)
        context = browser.new_context()
        page = context.new_page()
        link = context.new_cdp_session(page)
        page.goto(alone.url)
        slow_down(link, 6 * 2**20)
        choose(page, log)
        page.click("dialog .primary")
        page.wait_for_selector(".upload[data-state=sending]", timeout=60_000)
        until(lambda: page.evaluate("document.querySelector('.upload progress').value") > 0.02, 60)
        page.click(".upload button:text('Pause')")
        page.wait_for_selector(".upload[data-state=paused]")
        file = httpx2.get(f"{alone.url}/v1/drives").json()["drives"][0]
        assert file["state"] == "uploading"
        page.click(".upload button:text('Go on')")
        page.wait_for_selector(".upload[data-state=sending]")
        until(lambda: stored(alone.data) > 2**20, 60)
        page.on("dialog", lambda asked: asked.accept())
        page.reload()
        there = stored(alone.data)
        assert 0 < there < LARGE
        slow_down(link, -1)
        choose(page, log)
        page.click("dialog .primary")
        until(lambda: page.locator(".upload").get_attribute("data-state") == "sent", 120)
        path = alone.data / "drives" / file["id"] / "log" / "image_0" / "000000.png"
        whole = (log / "image_0" / "000000.png").read_bytes()
        assert hashlib.sha256(path.read_bytes()).digest() == hashlib.sha256(whole).digest()
        context.close()


@pytest.mark.browser
def test_small_files_go_in_packs_that_go_on_after_a_reload(browser: Any, tmp_path: Path) -> None:
    log = folder(tmp_path, (20_000,) * 600)
    with closing(ApiAlone(tmp_path / "data")) as alone:
        answering(alone.url)
        context = browser.new_context()
        page = context.new_page()
        link = context.new_cdp_session(page)
        asked: list[tuple[str, str]] = []
        page.on("request", lambda request: asked.append((request.method, request.url.removeprefix(alone.url))))
        page.goto(alone.url)
        slow_down(link, 3 * 2**20)
        choose(page, log)
        page.click("dialog .primary")
        until(lambda: arrived(alone) > 100, 60)
        words = page.inner_text(".upload .words")
        assert 0 < int(words.rpartition("· ")[2].split()[0]) < 601, words
        page.on("dialog", lambda dialog: dialog.accept())
        page.reload()
        before = arrived(alone)
        assert before < 601
        packs = [url for method, url in asked if method == "POST" and url.endswith("/packs")]
        assert len(packs) == 2
        asked.clear()
        slow_down(link, -1)
        choose(page, log)
        page.click("dialog .primary")
        until(lambda: page.locator(".upload").get_attribute("data-state") == "sent", 60)
        assert not [url for method, url in asked if method == "POST" and url.endswith("/packs")]  # those of before go on
        assert not [url for method, url in asked if method == "POST" and url == "/v1/uploads"]
        assert 1 <= len([url for method, url in asked if method == "PATCH"]) <= 2  # the small one of the two may be whole
        (drive,) = httpx2.get(f"{alone.url}/v1/drives").json()["drives"]
        assert (drive["state"], drive["received_files"]) == ("queued", 601)
        stored = alone.data / "drives" / drive["id"] / "log" / "image_0"
        assert all((stored / path.name).read_bytes() == path.read_bytes() for path in (log / "image_0").iterdir())
        context.close()


def arrived(alone: ApiAlone) -> int:
    """Whole files of the one drive."""
    drives = httpx2.get(f"{alone.url}/v1/drives").json()["drives"]
    return int(drives[0]["received_files"]) if drives else 0


def slow_down(link: Any, bytes_a_second: int) -> None:
    about = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": bytes_a_second}
    link.send("Network.enable")
    link.send("Network.emulateNetworkConditions", about)


def stored(data: Path) -> int:
    """Bytes of unfinished uploads."""
    return sum(path.stat().st_size for path in (data / "uploads").glob("*.part"))


@pytest.mark.browser
def test_a_dropped_folder_is_offered_and_a_cancelled_upload_leaves_the_page(browser: Any, tmp_path: Path) -> None:
    with closing(ApiAlone(tmp_path / "data")) as alone, watched(browser, alone.url) as page:
        page.wait_for_selector("#send button")
        page.evaluate(DROP)
        page.wait_for_selector("dialog")
        assert "2 files, 1 kB" in page.inner_text("dialog")
        assert page.input_value("dialog input[name=name]") == "lane"
        page.click("dialog .primary")
        page.wait_for_selector(".upload[data-state=sent]")
        page.click(".upload button:text('Close')")
        page.wait_for_selector(".upload", state="detached")
        (drive,) = httpx2.get(f"{alone.url}/v1/drives").json()["drives"]
        assert (drive["name"], drive["state"], drive["received_files"]) == ("lane", "queued", 2)


@pytest.mark.browser
def test_a_gnss_log_from_elsewhere_goes_beside_the_drive(browser: Any, tmp_path: Path) -> None:
    fixes = tmp_path / "fixes.csv"
    fixes.write_text("time_s,latitude,longitude\n1.0,49.0,8.4\n")
    with closing(ApiAlone(tmp_path / "data")) as alone, watched(browser, alone.url) as page:
        choose(page, folder(tmp_path, (1000, 2000)))
        page.set_input_files("dialog input[name=gnss]", str(fixes))
        page.click("dialog .primary")
        page.wait_for_selector(".upload[data-state=sent]")
        (drive,) = httpx2.get(f"{alone.url}/v1/drives").json()["drives"]
        assert (drive["state"], drive["files"]) == ("queued", 4)
        assert (alone.data / "drives" / drive["id"] / "gnss" / "fixes.csv").read_bytes() == fixes.read_bytes()
        database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
        with closing(database), database.read() as session:
            assert get(session, drive["id"]).manifest["gnss"] == "gnss/fixes.csv"


DROP = """() => {
  const file = (name, text) => ({ isFile: true, name, file: (give) => give(new File([text], name)) });
  const below = [[file("a.png", "x".repeat(500)), file("b.png", "y".repeat(400))], []];
  const entry = { isFile: false, name: "lane", createReader: () => ({ readEntries: (give) => give(below.shift()) }) };
  const event = new Event("drop", { bubbles: true, cancelable: true });
  event.dataTransfer = { types: ["Files"], items: [{ webkitGetAsEntry: () => entry }] };
  document.body.dispatchEvent(event);
}"""
