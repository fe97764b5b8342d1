"""Frame times of the 3D page in software rendering: a turning view of many points, each frame waited for.

python benchmarks/view3d.py [--points 500000] [--frames 24] [--write]
"""

import argparse
import os
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "tiles"))

from made_maps import made_map, made_tracks

from pages import put_between_marks
from service_kit.browsers import chromium
from service_kit.made_version import served_map

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "view3d.md"
SIZE = {"width": 1280, "height": 800}
HEAD = "| points drawn | tiles | picture, px | median, ms | 95 %, ms | seconds to settle |\n| --- | --- | --- | --- | --- | --- |"


def measured(points: int, frames: int) -> str:
    """A row of the table."""
    city = made_map(points, extent_m=250.0)
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(served_map(Path(folder) / "data", city, made_tracks(city))) as api,
        chromium() as browser,
    ):
        page = browser.new_page(viewport=SIZE, bypass_csp=True)  # what waits here evaluates text
        started = time.monotonic()
        page.goto(f"{api.url}/3d#at=8.39,48.98,115&view=400,0,45")
        page.wait_for_function("globalThis.wayloom3d?.scene?.isSettled && wayloom3d.scene.points", timeout=300_000)
        page.evaluate("wayloom3d.scene.detailPx = 0.01; wayloom3d.scene.redraw()")
        page.wait_for_timeout(500)
        page.wait_for_function("wayloom3d.scene.isSettled", timeout=300_000)
        settled_s = time.monotonic() - started
        page.evaluate("wayloom3d.scene.measure(3)")
        times = page.evaluate(f"wayloom3d.scene.measure({frames})")
        drawn, tiles = page.evaluate("[wayloom3d.scene.points, wayloom3d.scene.tiles().length]")
        width, height = page.evaluate("[wayloom3d.scene.canvas.width, wayloom3d.scene.canvas.height]")
    median, late = np.percentile(times, [50, 95])
    return f"| {drawn:,} | {tiles} | {width} × {height} | {median:.0f} | {late:.0f} | {settled_s:.0f} |"


def main() -> None:
    """Print the table, or write it into its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=500_000)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    load = os.getloadavg()[0]
    rows = (
        f"{HEAD}\n{measured(asked.points, asked.frames)}\n\n{os.cpu_count()} cores; load of the machine when it began: {load:.1f}."
    )
    print(rows)
    if asked.write:
        put_between_marks(PAGE, "frames", rows)


if __name__ == "__main__":
    main()
