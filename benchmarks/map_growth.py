"""What one more drive costs the service's map as it grows; the table of docs/benchmarks/map_growth.md.

    python benchmarks/map_growth.py [--drives 10,100] [--write]

Light made drives, a submap of 60 m and 2,000 points each, on streets of their own in a square grid. The map is filled to so many
drives in one version; then five come one by one, each a version. Stitch and publish run in this process as in a worker.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / room) for room in ("core", "workers")]

import numpy as np  # noqa: E402
from sqlalchemy import func, select  # noqa: E402

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.config.progress import silent  # noqa: E402
from wayloom.geodesy import wgs84  # noqa: E402
from wayloom.geodesy.map_frame import MapFrame  # noqa: E402
from wayloom.pipeline.settings import WayloomSettings  # noqa: E402
from wayloom.store import drives, gate, maps  # noqa: E402
from wayloom.store.jobs import Claim  # noqa: E402
from wayloom.store.manifest import Manifest, ManifestFile  # noqa: E402
from wayloom.store.migrate import upgrade  # noqa: E402
from wayloom.store.tables.maps import RegionRow, TileRow  # noqa: E402
from wayloom.submaps.submap import PlacedSubmap, Submap  # noqa: E402
from wayloom_workers.__main__ import make_context  # noqa: E402
from wayloom_workers.publishing import publish  # noqa: E402
from wayloom_workers.stage_hooks import StageAttempt, WorkerContext  # noqa: E402
from wayloom_workers.stitching import stitch  # noqa: E402
from wayloom_workers.submap_rows import submap_row  # noqa: E402

PAGE = DOCS / "benchmarks" / "map_growth.md"
FRAME = MapFrame(8.5, 48.5, 0.0)
LON, LAT = 8.4, 48.6
STREET_M, POINTS, NEW = 250.0, 2000, 5
HEAD = """| drives before | one more: CPU s, median | all five | regions written | rows of tiles | kB | peak memory, MB |
| --- | --- | --- | --- | --- | --- | --- |"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", default="10,100")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    rows = [HEAD]
    for count in map(int, options.drives.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            rows.append(grown(Path(folder), count))
        print("\n".join(rows), flush=True)
    if options.write:
        put_between_marks(PAGE, "growth", "\n".join(rows))


def grown(folder: Path, count: int) -> str:
    context = make_context(WayloomSettings(data_dir=folder / "data", map_origin=(FRAME.lon_deg, FRAME.lat_deg, FRAME.height_m)))
    upgrade(context.database)
    side = int(np.ceil(np.sqrt(count + NEW)))
    for number in range(count):
        add(context, number, side)
    next_version(context, folder / "fill")
    costs = []
    for number in range(count, count + NEW):
        add(context, number, side)
        before = written(context)
        began = time.process_time()
        next_version(context, folder / str(number))
        costs.append((time.process_time() - began, *(now - old for now, old in zip(written(context), before, strict=True))))
    context.database.close()
    seconds, regions, tiles, size = np.array(costs).T
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    each = ", ".join(f"{one:.2f}" for one in seconds)
    return (
        f"| {count} | {np.median(seconds):.2f} | {each} | {np.median(regions):.0f} | {np.median(tiles):.0f} | "
        f"{np.median(size) / 1e3:.0f} | {peak:.0f} |"
    )


def add(context: WorkerContext, number: int, side: int) -> None:
    """A drive on a street of its own."""
    rng = np.random.default_rng(number)
    xyz = (rng.uniform(-1.0, 1.0, (POINTS, 3)) * (30.0, 10.0, 2.0)).astype(np.float32)
    label = rng.choice([0, 1, 2, 8], POINTS).astype(np.uint8)
    T = np.stack([np.eye(4), np.eye(4)])
    T[1, 0, 3] = 30.0
    submap = Submap(
        xyz=xyz, label=label, variance=np.full(POINTS, 0.01, np.float32), grey=np.zeros(POINTS, np.uint8),
        seen_ns=np.arange(POINTS), keyframe=np.zeros(POINTS, np.uint32), vote_start=np.arange(POINTS + 1, dtype=np.uint32),
        vote_class=label, vote_weight=np.full(POINTS, 0.1, np.float32), keyframe_frame=np.arange(2, dtype=np.uint32),
        keyframe_t_ns=np.array([0, 10**9]), T_submap_cam=T, length_m=60.0, points_left_out={},
    )  # fmt: skip
    T_enu_submap = np.eye(4)
    T_enu_submap[:3, 3] = wgs84.enu_from_lonlatheight(np.array([[LON, LAT, 110.0]]), FRAME)[0]
    T_enu_submap[:2, 3] += STREET_M * np.array(divmod(number, side))
    with context.database.write() as session:
        manifest = Manifest(name=str(number), files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        placed = PlacedSubmap(submap, T_enu_submap, np.eye(6) * 1e-4, drive_id, FRAME)
        context.blobs.put(submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, placed)])
        gate.judge(session, drive_id, "A", [], "merge")


def next_version(context: WorkerContext, folder: Path) -> None:
    folder.mkdir()
    attempt = StageAttempt(context, Claim(1, 1, "stitch", 1, None, "city", {}), None, None, folder, {}, folder, silent)
    (folder / "inputs").mkdir()
    stitch(attempt)
    (folder / "inputs" / "stitch").symlink_to(folder, target_is_directory=True)
    with context.database.write() as session:
        publish(session, StageAttempt(context, attempt.claim, None, None, folder / "inputs", {}, folder, silent))


def written(context: WorkerContext) -> tuple[int, int, int]:
    """Rows of regions and of tiles, and bytes of their blobs, so far."""
    with context.database.read() as session:
        regions, tiles = (session.scalar(select(func.count()).select_from(table)) or 0 for table in (RegionRow, TileRow))
        sizes = [session.scalar(select(func.sum(table.size))) or 0 for table in (RegionRow, TileRow)]
    return regions, tiles, int(sum(sizes))


if __name__ == "__main__":
    main()
