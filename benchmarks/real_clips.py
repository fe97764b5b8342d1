"""Makes the tables of docs/results.md: `python benchmarks/real_clips.py [--data FOLDER] [--json FILE] [--write]`, or `make bench`.

FOLDER holds the recordings as docs/results.md describes them; default is what WAYLOOM_DATA names, else ../shared/data.
--write puts the tables into docs/results.md, between its two marks.
--decoding measures instead what it costs to decode clip A's images (docs/decisions/0023).
"""

import argparse
import json
import os
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pages import DOCS, put_between_marks
from wayloom.evaluation.georeference import TrackDistance
from wayloom.evaluation.recordings import RecordingRow, measure_kitti_odometry, measure_kitti_raw
from wayloom.logs.images import plain_png
from wayloom.logs.images.image_files import check_png
from wayloom.logs.kernels.png_rows import unfilter

ROOT = Path(__file__).resolve().parents[1]
RESULTS = DOCS / "results.md"
DECODED, ROUNDS = 60, 5


def measured(data: Path) -> list[RecordingRow]:
    """One row a recording."""
    oxts = data / "kitti_oxts" / "2011_10_03" / "2011_10_03_drive_0027_sync"
    return [
        measure_kitti_odometry(data / "kitti_odometry" / "sequences" / "00", oxts, "A", fault_until=16),
        measure_kitti_raw(data / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync", "B"),
    ]


def table(rows: list[RecordingRow]) -> str:
    """Two Markdown tables: the odometry against truth, the map against the INS."""
    lines = [
        "| clip | truth | frames tracked | segments | ATE (m) | t_rel (%) | r_rel (°/100 m) | length ratio | disparity bias (px) |"
        " CPU ms a frame | points a metre |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        for truth, e in row.errors.items():
            tracked = f"{row.tracked} of {row.frames} | {row.segments}"
            error = f"{e.ate_m:.3f} | {e.t_rel_percent:.2f} | {e.r_rel_deg_per_100m:.2f} | {e.length_ratio:.4f}"
            rest = f"{row.disparity_bias_px:.2f} | {row.cpu_ms_per_frame:.0f} | {row.points_per_m:.0f}"
            lines.append(f"| {row.name} | {truth} | {tracked} | {error} | {rest} |")
    lines += [
        "",
        "| clip | fixes given | horizontal (m): median, p95, max | vertical (m): median, p95, max |",
        "| --- | --- | --- | --- |",
    ]
    for row in rows:
        lines += [distance_line(row.name, given, d) for given, d in (("all", row.to_ins), ("one in 20", row.to_ins_sparse)) if d]
    return "\n".join(lines) + "\n"


def distance_line(name: str, given: str, distance: TrackDistance) -> str:
    """One row of the second table."""
    h, v = distance.horizontal, distance.vertical
    return f"| {name} | {given} | {h.median_m:.3f}, {h.p95_m:.3f}, {h.max_m:.3f} | {v.median_m:.3f}, {v.p95_m:.3f}, {v.max_m:.3f} |"


def decoding(folder: Path) -> str:
    """A Markdown table: processor time of decoding a grey PNG, the best of some rounds of each image, all ways in turn."""
    files = sorted(folder.glob("*.png"))[:DECODED]
    ways: dict[str, Callable[[bytes], NDArray[np.uint8]]] = {
        "isal, rows by a kernel": lambda data: plain_png.decode(check_png(data, folder)),
        "zlib, rows by a kernel": lambda data: _with_zlib(check_png(data, folder)),
        "OpenCV": lambda data: cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE),
    }
    images = [file.read_bytes() for file in files]
    assert all(np.array_equal(way(images[0]), ways["OpenCV"](images[0])) for way in ways.values())
    best = {name: np.full(len(images), np.inf) for name in ways}
    for _ in range(ROUNDS):
        for i, data in enumerate(images):
            for name, way in ways.items():
                start = time.process_time()
                way(data)
                best[name][i] = min(best[name][i], time.process_time() - start)
    rows = [f"| {name} | {1e3 * seconds.mean():.2f} |" for name, seconds in best.items()]
    return "\n".join(["| decoder | ms an image |", "| --- | --- |", *rows]) + "\n"


def _with_zlib(chunks: list[tuple[bytes, memoryview]]) -> NDArray[np.uint8]:
    """As plain_png.decode, with the standard library."""
    header = chunks[0][1]
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    stream = b"".join(content for kind, content in chunks if kind == b"IDAT")
    rows = zlib.decompressobj().decompress(stream, (width + 1) * height + 1)
    image = np.empty((height, width), np.uint8)
    unfilter(np.frombuffer(rows, np.uint8).reshape(height, width + 1), 1, image)
    return image


def main() -> None:
    """Measure, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT.parent / "shared" / "data")))
    parser.add_argument("--json", type=Path, help="also write all numbers to this file")
    parser.add_argument("--write", action="store_true", help="put the table into docs/results.md")
    parser.add_argument("--decoding", action="store_true", help="measure the decoding of images instead")
    options = parser.parse_args()
    if not options.data.is_dir():
        sys.exit(f"no folder {options.data}: set WAYLOOM_DATA or give --data")
    if options.decoding:
        print(decoding(options.data / "kitti_odometry" / "sequences" / "00" / "image_0"), end="")
        return
    rows = measured(options.data)
    if not all(row.same_twice for row in rows):
        sys.exit("two runs of one recording gave different trajectories")
    text = table(rows)
    print(text, end="")
    if options.json:
        options.json.write_text(json.dumps([row.as_json() for row in rows], indent=1) + "\n")
    if options.write:
        put_between_marks(RESULTS, "real clips", text)


if __name__ == "__main__":
    main()
