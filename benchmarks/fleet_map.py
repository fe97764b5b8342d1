"""A simulated fleet through the stitch of the service, with truth; tables as docs/benchmarks/fleet_map.md has them.

    python benchmarks/fleet_map.py OUT LOG [OUT LOG ...] [--write NAME] [--places FILE]

OUT is what `wayloom process LOG --gnss LOG/gnss.csv`, or without GNSS, left of a drive, LOG the drive as simulated with truth; all
of one city. Every drive goes through the gate of the service; those that it merges, and those that are held for their place, are
registered with each other, placed, merged and cut into tiles, as the service does. Places are judged at the submaps' anchors
against the truth. `--places` keeps them, for `stitching.py accuracy --poses joined --places FILE`.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
from itertools import combinations
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / room) for room in ("core", "workers", "tests")]

import numpy as np  # noqa: E402

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.config.gate import gate_of  # noqa: E402
from wayloom.config.progress import silent  # noqa: E402
from wayloom.geodesy import wgs84  # noqa: E402
from wayloom.geodesy.map_frame import MapFrame  # noqa: E402
from wayloom.geometry import se3  # noqa: E402
from wayloom.logs.simulated_truth import open_truth  # noqa: E402
from wayloom.pipeline.drive_quality import QUALITY_FILE, read_quality  # noqa: E402
from wayloom.pipeline.settings import WayloomSettings  # noqa: E402
from wayloom.simulation.recording.presets import CITY_ORIGIN  # noqa: E402
from wayloom.store import drives, gate, maps  # noqa: E402
from wayloom.store.jobs import Claim, new_job  # noqa: E402
from wayloom.store.manifest import Manifest, ManifestFile  # noqa: E402
from wayloom.store.migrate import upgrade  # noqa: E402
from wayloom.submaps.files import load_submaps  # noqa: E402
from wayloom_workers.__main__ import make_context  # noqa: E402
from wayloom_workers.completion import complete_drive  # noqa: E402
from wayloom_workers.publishing import publish  # noqa: E402
from wayloom_workers.stage_hooks import StageAttempt, WorkerContext  # noqa: E402
from wayloom_workers.stitching import stitch  # noqa: E402
from wayloom_workers.submap_rows import submap_row  # noqa: E402

PAGE = DOCS / "benchmarks" / "fleet_map.md"
COLUMNS = ("drive", "grade, gate", "in the map by", "own GNSS: level m, height m", "in the map: level m, height m")
MORE = ("stated, m rms", "errors / sigma, rms")
HEAD = f"| {' | '.join(COLUMNS + MORE)} |\n|{' --- |' * len(COLUMNS + MORE)}"
ABSENT = "–"
PAIR_HEAD = """| drives | share of road | against each other, own GNSS, m | in the map, m |
| --- | --- | --- | --- |"""
NEAR_M = 30.0
Places = tuple[np.ndarray, np.ndarray] | None
"""T_enu_submap and covariance; None without a place."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="OUT LOG")
    parser.add_argument("--write", metavar="NAME", help="put the tables between the marks of this name on the page")
    parser.add_argument("--places", type=Path, metavar="FILE", help="npz of the submaps' places in the map, by drive")
    options = parser.parse_args()
    if len(options.folders) % 2:
        parser.error("give an OUT and a LOG for each drive")
    both = list(zip(options.folders[::2], options.folders[1::2], strict=True))
    outs = {name_of(out, log): out for out, log in both}
    truth = {name_of(out, log): true_anchors(out, log) for out, log in both}
    with tempfile.TemporaryDirectory() as folder:
        text, in_map = measured(Path(folder), outs, truth)
    print(text)
    if options.write:
        put_between_marks(PAGE, options.write, text)
    if options.places:
        kept = {log.name: in_map[name_of(out, log)] for out, log in both}
        np.savez(options.places, **{f"{name}.{what}": a for name, p in kept.items() if p for what, a in zip("TC", p, strict=True)})


def measured(folder: Path, outs: dict[str, Path], truth: dict[str, np.ndarray]) -> tuple[str, dict[str, Places]]:
    context = make_context(WayloomSettings(data_dir=folder / "data"))
    upgrade(context.database)
    ids = {name: add(context, name, out) for name, out in outs.items()}
    own = {name: places(context, drive_id) for name, drive_id in ids.items()}
    began = time.process_time()
    facts = stitched(context, folder)
    seconds = time.process_time() - began
    verdicts = {name: verdict_of(context, drive_id) for name, drive_id in ids.items()}
    now = {name: places(context, drive_id) if verdicts[name][1] else None for name, drive_id in ids.items()}
    context.database.close()
    rows = [row_of(name, verdicts[name], own[name], now[name], truth[name]) for name in sorted(ids)]
    pairs = [pair_row((a, b), own, now, truth) for a, b in combinations(sorted(ids), 2)]
    refused = sum(facts["aligned"]["refused"].values())
    said = f"{facts['aligned']['meetings']} meetings, {refused} refused by the graph; {seconds:.0f} CPU s in all."
    return "\n".join([said, "", HEAD, *rows, "", PAIR_HEAD, *(pair for pair in pairs if pair)]), now


def name_of(out: Path, log: Path) -> str:
    """The drive's name, and why it has no place of its own where it has none."""
    quality = quality_of(out)
    return log.name if quality["placed"] else f"{log.name}, {'no GNSS' if quality['fixes'] is None else 'fixes laid aside'}"


def quality_of(out: Path) -> dict:
    return read_quality(out / "stages" / "georeference" / QUALITY_FILE)


def true_anchors(out: Path, log: Path) -> np.ndarray:
    """(n, 4, 4) T_enu_cam of the anchors of a drive's submaps, in the city's tangent plane."""
    T = open_truth(log).T_enu_cam
    found = []
    for item in load_submaps(out / "stages" / "submaps"):
        anchor = np.argmin(np.linalg.norm(item.submap.T_submap_cam[:, :3, 3], axis=1))
        found.append(T[int(item.submap.keyframe_frame[anchor])])
    return np.array(found)


def add(context: WorkerContext, name: str, out: Path) -> str:
    """A processed drive, as the workers leave it."""
    with context.database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        for stage in ("places", "submaps"):
            target = context.folders.drive(drive_id) / "stages" / stage
            target.mkdir(parents=True)
            shutil.copytree(out / "stages" / stage, target / "key")
            session.add(new_job(stage, 0.0, state="done", drive_id=drive_id, position=0, payload={"key": "key"}))
        items = load_submaps(out / "stages" / "submaps")
        for item in items:
            context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", i, item) for i, item in enumerate(items)])
        quality = quality_of(out)
        drives.get(session, drive_id).placed = quality["placed"]
        verdict = gate_of(quality["grade"], context.settings.gate, quality["sound"])
        gate.judge(session, drive_id, quality["grade"], quality["reasons"], verdict, quality["sound"])
        complete_drive(session, drive_id)
    return drive_id


def verdict_of(context: WorkerContext, drive_id: str) -> tuple[str, str, str]:
    """Grade and gate; by what the drive is in the map, empty where it is not; and why it is not."""
    with context.database.read() as session:
        drive = drives.get(session, drive_id)
        said = (drive.map_verdict or {}).get("reason", "")
        by = "its own grade" if gate.passes(drive) else said if drive.admitted else ""
        return f"{drive.grade or ABSENT}, {drive.gate}", by, said or drive.reasons[1 if len(drive.reasons) > 1 else 0]


def stitched(context: WorkerContext, folder: Path) -> dict:
    """Stitch and publish once; the facts of the version."""
    out_dir = folder / "stitch"
    out_dir.mkdir()
    attempt = StageAttempt(context, Claim(1, 1, "stitch", 1, None, "city", {}), None, None, folder, {}, out_dir, silent)
    stitch(attempt)
    with context.database.write() as session:
        publish(session, attempt)
        return maps.version(session, "city").facts


def places(context: WorkerContext, drive_id: str) -> Places:
    """T_enu_submap (n, 4, 4) in the city's tangent plane, and covariance (n, 6, 6) of its left perturbation there."""
    with context.database.read() as session:
        rows = maps.submaps_of(session, drive_id)
    if rows[0].frame is None:
        return None
    T_city_row = wgs84.T_enu_enu(CITY_ORIGIN, MapFrame(*rows[0].frame))
    Ad = se3.adjoint(T_city_row)
    T = np.array([T_city_row @ np.array(row.T_enu_submap) for row in rows])
    return T, np.array([Ad @ np.array(row.covariance) @ Ad.T for row in rows])


def row_of(name: str, verdict: tuple[str, str, str], own: Places, now: Places, truth: np.ndarray) -> str:
    graded, by, why_not = verdict
    before = ABSENT if own is None else split(own[0], truth)
    if now is None:
        return f"| {name} | {graded} | not: {why_not} | {before} | {ABSENT} | {ABSENT} | {ABSENT} |"
    sigma2 = place_covariance(*now)
    off = now[0][:, :3, 3] - truth[:, :3, 3]
    chi2 = np.einsum("ni,nij,nj->n", off, np.linalg.inv(sigma2), off) / 3.0
    stated = np.sqrt(np.trace(sigma2, axis1=1, axis2=2).mean())
    return f"| {name} | {graded} | {by} | {before} | {split(now[0], truth)} | {stated:.2f} | {np.sqrt(chi2.mean()):.1f} |"


def place_covariance(T: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of the anchors' places from covariances of the left perturbation."""
    lever = np.zeros((len(T), 3, 6))
    lever[:, :, :3] = np.eye(3)
    lever[:, :, 3:] = -se3.hat(T[:, :3, 3])
    return lever @ covariance @ np.swapaxes(lever, 1, 2)


def split(T: np.ndarray, truth: np.ndarray) -> str:
    off = T[:, :3, 3] - truth[:, :3, 3]
    return f"{np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()):.2f}, {np.sqrt((off[:, 2] ** 2).mean()):.2f}"


def pair_row(names: tuple[str, str], own: dict[str, Places], now: dict[str, Places], truth: dict[str, np.ndarray]) -> str:
    """How far submaps of two drives that are near each other lie elsewhere against each other than in truth, rms."""
    a, b = (truth[name][:, :3, 3] for name in names)
    i, j = np.nonzero(np.linalg.norm(a[:, None] - b[None], axis=2) < NEAR_M)
    if not len(i):
        return ""
    shares = "/".join(str(len(set(rows.tolist()))) + " of " + str(len(all_)) for rows, all_ in ((i, a), (j, b)))

    def apart(T: dict[str, Places]) -> str:
        one, other = T[names[0]], T[names[1]]
        if one is None or other is None:
            return ABSENT
        found = other[0][j, :3, 3] - one[0][i, :3, 3]
        return f"{np.sqrt(((found - (b[j] - a[i])) ** 2).sum(axis=1).mean()):.2f}"

    return f"| {', '.join(names)} | {shares} | {apart(own)} | {apart(now)} |"


if __name__ == "__main__":
    main()
