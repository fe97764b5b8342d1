"""A service with something to show on every page: drives in every state, one with results, keys, an excluded area, tiles."""

import hashlib
import json
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from service_kit import little_stages
from service_kit.running import ApiAlone
from wayloom.config.roles import Role
from wayloom.store import drives, maps
from wayloom.store.access import keys
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.history import note_event
from wayloom.store.map_versions import NewVersion, TileEntry, publish
from wayloom.tiles.png import png_bytes
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import placed

Filled = tuple[ApiAlone, dict[str, str]]
"""The service, and its drives by their states."""
STATES = ("uploading", "queued", "running", "stitching", "done", "held", "quarantined", "failed")
CAMERA = {"width": 640, "height": 320, "fx": 300.0, "fy": 300.0, "cx": 320.0, "cy": 160.0, "baseline_m": 0.5}
LOG = {
    "format": "kitti-odometry", "bytes": 35_000_000, "camera": CAMERA, "missing": ["lever arm"], "start": "2026-06-01 08:00:00",
    "frames": {"count": 300, "duration_s": 30.0, "gaps": [{"seconds": 2.0}]},
}  # fmt: skip
YARD = {"type": "Polygon", "coordinates": [[[8.4, 49.0], [8.41, 49.0], [8.41, 49.01], [8.4, 49.0]]]}


def quality() -> dict[str, object]:
    """A report with every series: a bend of 300 m with a burst of its GNSS."""
    t = np.linspace(0.0, 30.0, 120)
    residual = np.stack([0.02 * np.sin(t), 0.03 * np.cos(t), 0.05 * np.sin(2 * t)])
    residual[0, 40:50] += 4.0
    used = np.ones(len(t), bool)
    used[40:50] = False
    sigma = np.stack([0.02 + 0.001 * t] * 3)
    return {
        "fixes": {
            "count": 120, "t_s": t.tolist(), "residual_enu_m": residual.tolist(), "sigma_enu_m": sigma.tolist(),
            "used": used.tolist(),
        },
        "placed": True, "bursts": [{"from_s": 10.0, "to_s": 12.5, "offset_enu_m": [4.0, 0.0, 0.0]}], "receiver": None,
        "scale": {"mean": 1.031, "sigma": 0.001}, "loops": None, "pictures": {},
        "track": {
            "t_s": t.tolist(), "road_m": (10 * t).tolist(), "plane_m": [(10 * t).tolist(), (0.1 * t**2).tolist(), (0 * t).tolist()],
            "sigma": {"enu_m": sigma.tolist(), "heading_deg": (0.05 + 0.001 * t).tolist()},
        },
        "drift": {
            "road_m": (10 * t).tolist(), "odometry_m": (0.005 * t).tolist(), "over_m": 100.0,
            "percent": {"median": 0.4, "worst": 1.1}, "deg_per_100m": {"median": 0.1, "worst": 0.3},
        },
    }  # fmt: skip


def fill(alone: ApiAlone) -> dict[str, str]:
    """Fill the service. Returns the id of a drive by its state."""
    with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
        ids = {state: _announce(http, f"street {state}") for state in STATES}
        feature = {"type": "Feature", "properties": {"name": "yard"}, "geometry": YARD}
        assert http.post("/v1/excluded-areas", json=feature).status_code == 201
    blobs, database = BlobStore(alone.data / "blobs"), Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with database.write() as session:
        for state, drive_id in ids.items():
            _set_state(session, drive_id, state)
        _set_results(session, blobs, ids["done"])
        keys.create(session, "van of the tests", Role.VEHICLE, "van-1", None)
        _publish(session, blobs)
    database.close()
    return ids


def _announce(http: httpx2.Client, name: str) -> str:
    file = {"path": "log/a", "size": 10, "sha256": hashlib.sha256(name.encode()).hexdigest()}
    return str(http.post("/v1/drives", json={"name": name, "vehicle_id": "van-1", "files": [file]}).json()["id"])


def _set_state(session: Session, drive_id: str, state: str) -> None:
    row = drives.get(session, drive_id)
    row.state = state
    row.uploaded_at = None if state == "uploading" else row.created_at
    if state == "failed":
        row.error = "odometry: frame 12 is black"
    if state in ("held", "quarantined"):
        row.grade, row.gate = "D", "hold" if state == "held" else "quarantine"
        row.reasons, row.placed = ["sigma of the position 2.00 m in the median"], True
    for what in ("begun", "again", "begun", "lost", "done"):
        note_event(
            session, drive_id, "odometry", what, attempt=1, text="evidence" if what == "lost" else "", worker="host/boot|77|1"
        )


def _set_results(session: Session, blobs: BlobStore, drive_id: str) -> None:
    row, item = drives.get(session, drive_id), placed(drive_id, 7)
    digest = blobs.put(item.submap.encoded)
    maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
    row.grade, row.gate, row.reasons, row.placed, row.sound = "B", "merge", ["sigma of the position 0.30 m"], True, True
    lon, lat = little_stages.LON, little_stages.LAT
    row.track = [[lon, lat, 100.0], [lon + 0.001, lat + 0.0005, 100.0]]
    georeference = {"scale": {"mean": 1.031, "sigma": 0.001}, "messages": [], "fixes": {"used": 110, "rejected": 10}}
    report = blobs.put(json.dumps(quality()).encode())
    row.facts = {"log": LOG, "georeference": georeference, "quality": report, "preview": digest}
    row.images = "deleted"


def _publish(session: Session, blobs: BlobStore) -> None:
    rgba = np.zeros((256, 256, 4), np.uint8)
    rgba[64:192, 32:224] = (128, 64, 128, 255)
    content = png_bytes(rgba)
    tiles = [TileEntry(**little_stages.tile(zoom, blobs.put(content), len(content))) for zoom in range(12, 19)]  # type: ignore[arg-type]
    bounds = (little_stages.LON, little_stages.LAT, little_stages.LON + 0.001, little_stages.LAT + 0.001)
    base = maps.ensure_map(session, "city").version
    publish(session, "city", NewVersion(base, (8.5, 49.5, 0.0), (), 1, bounds, tiles), kept=5)


def filled(folder: Path) -> Filled:
    """Such a service in a folder."""
    alone = ApiAlone(folder)
    return alone, fill(alone)


def change(alone: ApiAlone, drive_id: str, **values: Any) -> None:
    """A drive's row, as a worker would change it."""
    database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with closing(database), database.write() as session:
        row = drives.get(session, drive_id)
        for name, value in values.items():
            setattr(row, name, value)
