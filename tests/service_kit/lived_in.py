"""A service that has been used: a drive that went through small stages into the map, one that is on its way, a map with features, a
rig, a key, an excluded area, an unfinished upload, and the names of all of them."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from service_kit import little_stages, tus
from service_kit.guarded import API_KEY, Guarded, bearer
from service_kit.packed_drives import packed_drive
from service_kit.running import until
from wayloom.client.api import Api
from wayloom.client.upload import upload
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.marking_files import encode_features
from wayloom.store import maps, rigs
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.map_versions import NewVersion, RegionEntry, publish
from wayloom.store.rigs import NewRigVersion
from wayloom.store.sweep import unsent
from wayloom_workers.__main__ import make_context
from wayloom_workers.runner import run_job

FRAME = MapFrame(8.4, 49.0, 100.0)
KNOWN_TO_ALL: Mapping[str, list[Any]] = {
    "map_id": ["city", "town"], "number": [1, 2], "base": [0, 1], "east": [0], "north": [0],
    "part": ["voxels", "objects", "areas", "markings", "ground"], "layer": ["semantic", "parked", "objects"], "ext": ["png", "mvt"],
    "overlay": ["parked"], "name": ["objects", "areas", "tracks"], "feature_id": ["0.0.pole-0"], "picture": ["track"],
}  # fmt: skip


@contextmanager
def lived_in(data: Path, folder: Path) -> Iterator[tuple[Guarded, dict[str, list[Any]]]]:
    """The API of it alone, and for each parameter of a path what there is. The first of `drive_id` is the one to remove."""
    guarded = Guarded(data, WAYLOOM_ACCESS__STRANGERS_A_SECOND="100000", WAYLOOM_ACCESS__STRANGERS_AT_ONCE="100000")
    try:
        until(lambda: _answers(guarded.http), 120)
        guarded.http.headers.update(bearer(API_KEY))
        with Api(guarded.api.url, API_KEY) as api:
            ids = [upload(api, packed_drive(folder / name, name))["id"] for name in ("doomed", "whole")]
            _work(data)
            assert [api.drive(drive_id)["state"] for drive_id in ids] == ["done", "done"]
        blobs = BlobStore(Folders(data).blobs)
        _town(guarded.database, blobs, ids[1])
        yield guarded, {**KNOWN_TO_ALL, **_tile_of(guarded.http), **_things(guarded, blobs, ids)}
    finally:
        guarded.close()


def _work(data: Path) -> None:
    """All jobs that there are, one after the other, by small stages in this process."""
    context = make_context(WayloomSettings(data_dir=data))
    try:
        while waiting := unsent(context.database, 0.0):
            for message in waiting:
                run_job(context, little_stages.hooks, lambda _: None, message.job_id)
    finally:
        context.database.close()


def _answers(http: httpx2.Client) -> bool:
    try:
        return http.get("/healthz").status_code == 200
    except httpx2.HTTPError:
        return False


def _town(database: Database, blobs: BlobStore, drive_id: str) -> None:
    """A map of one region with an object and an area."""
    lon, lat, _ = wgs84.lonlatheight_from_enu(_points(3.0, 5.0), FRAME)[0].tolist()
    pole = {
        "type": "Feature", "id": "0.0.pole-0", "geometry": {"type": "Point", "coordinates": [lon, lat, 100.0]},
        "properties": {"kind": "pole", "id": "0.0.pole-0", "height_m": 2.5, "drives": [drive_id], "first_ns": 1, "last_ns": 2},
    }  # fmt: skip
    files = {"objects": blobs.put(encode_features([pole]))}
    region = RegionEntry(0, 0, "1" * 64, "1" * 64, [], 10, [], **files)
    with database.write() as session:
        maps.ensure_map(session, "town")
        frame = (FRAME.lon_deg, FRAME.lat_deg, FRAME.height_m)
        for base in (0, 1):
            said = NewVersion(base, frame, (drive_id,), 0, (lon, lat, lon + 0.001, lat + 0.001), [], regions=[region])
            publish(session, "town", said, kept=5)


def _points(x: float, y: float) -> Any:
    return np.array([[x, y, 0.0]])


def _tile_of(http: httpx2.Client) -> dict[str, list[Any]]:
    """Where a tile of the city is."""
    tile = http.get("/v1/maps/city/diff/0/1").json()["added"][0]
    return {name: [tile[name]] for name in ("z", "x", "y")}


def _things(guarded: Guarded, blobs: BlobStore, ids: list[str]) -> dict[str, list[Any]]:
    """Rig, key, area, upload and submap."""
    with guarded.database.write() as session:
        rig = rigs.ensure(session, "taxi", "roof").id
        new = NewRigVersion(10**18, "e" * 64, blobs.put(b"format_version = 2\n"), (ids[1],), "first drive", {})
        assert rigs.write(session, rig, 0, {}, [new], [], {})
    http = guarded.http
    key = http.post("/v1/keys", json={"name": "a van", "role": "vehicle", "vehicle_id": "van-1"}).json()
    square = [[8.0, 49.0], [8.001, 49.0], [8.001, 49.001], [8.0, 49.001], [8.0, 49.0]]
    area = {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [square]}, "properties": {"name": "yard"}}
    areas = http.post("/v1/excluded-areas", json=area).json()["features"]
    begun = tus.register(http, "on its way", a=b"0123456789")
    address = tus.create(http, begun, "log/a", 10).headers["Location"]
    return {
        "drive_id": [*ids, begun], "upload_id": [address.rpartition("/")[2]], "key": [rig], "prefix": [key["prefix"]],
        "area_id": [areas[0]["id"]], "digest": [ids[1]],
    }  # fmt: skip
