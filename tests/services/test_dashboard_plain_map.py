"""The dashboard in a browser without WebGL 2: everything is there, with a plain map."""

from pathlib import Path

import numpy as np
import pytest

from service_kit.browsers import chromium, tones
from service_kit.packed_drives import packed_drive
from service_kit.running import service, until
from wayloom.client.upload import upload
from wayloom.config.classes import PALETTE

MIDDLE = """(() => {
  const image = [...document.querySelectorAll(".plain-tiles img.semantic")].find((one) => one.naturalWidth === 256);
  const pen = new OffscreenCanvas(256, 256).getContext("2d");
  if (image) pen.drawImage(image, 0, 0);
  return [...pen.getImageData(128, 128, 1, 1).data].slice(0, 3);
})()"""


@pytest.mark.browser
def test_without_webgl_the_list_is_there_and_a_plain_map_is_moved_by_keys(tmp_path: Path) -> None:
    with chromium("--disable-3d-apis") as plain, service(tmp_path / "data") as up:
        first = upload(up.api(), packed_drive(tmp_path / "a", "first drive"))["id"]
        seen = plain.new_page(viewport={"width": 1000, "height": 700})
        wrong: list[str] = []
        seen.on("pageerror", lambda error: wrong.append(str(error)))
        seen.goto(up.url)
        seen.wait_for_selector(f"[data-id='{first}'][data-state=done]")
        until(lambda: seen.inner_text("#live") == "live")
        until(lambda: seen.locator(".plain-tiles img.semantic").count() > 0)
        assert "has no WebGL 2" in seen.inner_text(".plain-note")
        until(lambda: seen.evaluate("[...document.querySelectorAll('.plain-tiles img')].some((one) => one.naturalWidth === 256)"))
        for scheme in ("light", "dark"):  # a road of the little stages, which moves as a road does
            seen.emulate_media(color_scheme=scheme)
            wanted = np.array((128, 74, 128)) + tones(seen, scheme)[0] - PALETTE[0]
            until(lambda wanted=wanted: seen.evaluate(MIDDLE) == wanted.tolist())
        assert seen.locator(".plain-map polyline").count() == 1
        assert seen.locator("#legend .plain-keys span").all_inner_texts() == ["drives"]
        where = "document.querySelector('.plain-map polyline').getAttribute('points')"
        before = seen.evaluate(where)
        seen.focus(".plain-map")
        seen.keyboard.press("ArrowRight")
        moved = seen.evaluate(where)
        seen.click(".plain-buttons button[aria-label='Zoom in']")
        assert len({before, moved, seen.evaluate(where)}) == 3
        seen.click("#show-semantic")
        until(lambda: seen.locator(".plain-tiles img.semantic").count() == 0)
        seen.click(f"[data-id='{first}'] button, [data-id='{first}']")
        until(lambda: seen.locator("#legend .plain-keys span").all_inner_texts() == ["chosen drive"])
        seen.click("#show-tracks")
        until(lambda: seen.locator("#legend .plain-keys span").count() == 0)
        assert wrong == []
