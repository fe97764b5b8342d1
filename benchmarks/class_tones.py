"""Classes' colours on the dashboard's map: how they stand off its ground and each other, and the time that a picture takes.

    python benchmarks/class_tones.py [--pictures 200]

Colours are asked of the page itself in Chromium. *As they are* are the colours of Cityscapes, without any ground of their own.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from service_kit.browsers import answering, chromium, tones
from service_kit.colours import apart, contrast, distances
from service_kit.running import ApiAlone
from wayloom.config.classes import CLASS_ID, CLASS_NAMES, PALETTE

GROUND = "(scheme) => getComputedStyle(document.documentElement).getPropertyValue(`--map-${scheme}`).trim()"
ALONE = (("terrain", "vegetation"), ("traffic sign", "vegetation"))
TIMES = """async (count) => {
  const { ClassPixels, pixelsOf } = await import("/static/map/class_pixels.js");
  const { classes } = await (await fetch("/v1/info")).json();
  const pen = new OffscreenCanvas(256, 256).getContext("2d");
  for (let k = 0; k < 400; k++) {
    pen.fillStyle = classes[k % classes.length].colour;
    pen.fillRect((37 * k) % 256, (61 * k) % 256, 20, 20);
  }
  const blob = await pen.canvas.convertToBlob({ type: "image/png" });
  const own = new ClassPixels(classes);
  const times = { decoding: [], colours: [], bitmap: [] };
  for (let k = 0; k < count; k++) {
    const begun = performance.now();
    const pixels = await pixelsOf(blob);
    const decoded = performance.now();
    own.draw(pixels.data, "light", new Set());
    const drawn = performance.now();
    await createImageBitmap(pixels);
    times.decoding.push(decoded - begun), times.colours.push(drawn - decoded), times.bitmap.push(performance.now() - drawn);
  }
  return times;
}"""


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=200)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, closing(ApiAlone(Path(folder) / "data")) as api, chromium() as browser:
        page = browser.new_page()
        answering(api.url)
        page.goto(api.url)
        rows = [("as they are", PALETTE, None)]
        rows += [(scheme, tones(page, scheme), css_of(page.evaluate(GROUND, scheme))) for scheme in ("light", "dark")]
        times = page.evaluate(TIMES, options.pictures)
    pairs = " | ".join(f"{one} and {other}" for one, other in ALONE)
    print(f"| ground | least contrast | of | nearest pair | of | {pairs} |\n|{' --- |' * (5 + len(ALONE))}")
    for name, palette, ground in rows:
        print(row(name, palette, ground))
    print("\nA picture of 256 px, ms, median: " + ", ".join(f"{what} {np.median(found):.1f}" for what, found in times.items()))


def css_of(colour: str) -> str:
    """#rrggbb as rgb(r, g, b)."""
    return f"rgb{tuple(bytes.fromhex(colour[1:]))}"


def row(name: str, palette: Any, ground: str | None) -> str:
    """Of the classes' colours (19, 3) on a ground."""
    far = apart(palette)
    nearest = " and ".join(CLASS_NAMES[one] for one in np.argsort(far, kind="stable")[:2])
    seen: Sequence[float] = [contrast(f"rgb{tuple(colour)}", ground) for colour in palette.tolist()] if ground else []
    least = f"{min(seen):.2f} | {CLASS_NAMES[int(np.argmin(seen))]}" if seen else "– | –"
    told = [f"{distances(palette)[CLASS_ID[one], CLASS_ID[other]]:.3f}" for one, other in ALONE]
    return f"| {name} | {least} | {far.min():.3f} | {nearest} | {' | '.join(told)} |"


if __name__ == "__main__":
    main()
