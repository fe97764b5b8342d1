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
        until(lambda: page.inner_text(".upload .words").startswith("sent ·"))
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


@pytest.mark.browser
def test_what_is_no_log_and_what_lacks_its_calibration_is_told_before_it_is_sent(browser: Any, tmp_path: Path) -> None:
    other, raw = folder(tmp_path / "other", (10,)), tmp_path / "2011_09_26_drive_0001_sync"
    for camera in ("image_00", "image_01"):
        (raw / camera / "data").mkdir(parents=True)
        (raw / camera / "timestamps.txt").write_text("2011-09-26 13:02:44.336092940\n")
        (raw / camera / "data" / "0000000000.png").write_bytes(b"not yet looked at")
    (tmp_path / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\n")
    with closing(ApiAlone(tmp_path / "data")) as alone:
        answering(alone.url)
        page = browser.new_page()
        page.goto(alone.url)
        choose(page, other)
        assert "No file of it is called as those of a drive log are" in page.inner_text("dialog")
        assert page.is_enabled("dialog .primary")
        page.keyboard.press("Escape")
        choose(page, raw)
        assert "calib_cam_to_cam.txt" in page.inner_text("dialog")
        assert page.is_disabled("dialog .primary")
        page.set_input_files("dialog input[name=calibration]", str(tmp_path / "calib_cam_to_cam.txt"))
        page.click("dialog .primary")
        until(lambda: page.inner_text(".upload .words").startswith("sent ·"))
        (drive,) = httpx2.get(f"{alone.url}/v1/drives").json()["drives"]
        assert drive["files"] == 5
        assert (alone.data / "drives" / drive["id"] / "log" / "calib_cam_to_cam.txt").is_file()
        page.close()
