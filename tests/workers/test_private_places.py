"""A drive's places outlive its images, are handed to nobody, and go with their drive."""

import json
import os
import shutil
from pathlib import Path

from service_kit.packed_drives import packed_drive
from service_kit.running import service, until
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.places.files import MAGIC, PLACES_FILE, load_places
from wayloom.places.views import view_at


def holds_places(folder: Path) -> list[Path]:
    """Files below the folder that hold places, whatever they are called; workers may be tidying up while it is walked."""
    return [path for at, _, names in os.walk(folder) for name in names if _has_places(path := Path(at, name))]


def _has_places(path: Path) -> bool:
    try:
        return path.is_file() and MAGIC in path.read_bytes()[: 1 << 20]
    except FileNotFoundError:
        return False


def test_places_stay_without_images_and_go_with_their_drive(tmp_path: Path) -> None:
    with service(tmp_path / "data", WAYLOOM_STAGE_HOOKS="service_kit.place_stages:hooks") as up:
        api = up.api()
        drive_id = upload(api, packed_drive(tmp_path / "a", sizes=(10,) * 3))["id"]
        assert wait_for_drive(api, drive_id)["state"] == "done"
        home = up.data / "drives" / drive_id
        (path,) = (home / "stages" / "places").glob(f"*/{PLACES_FILE}")
        assert holds_places(up.data) == [path]
        shutil.rmtree(home / "log")
        view = view_at(load_places(path), 20)
        assert len(view) > 0
        assert len(view.features) > 0
        api.once("DELETE", f"/v1/drives/{drive_id}")
        until(lambda: not home.exists())
        assert holds_places(up.data) == []


def test_no_route_of_the_service_speaks_of_places(tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        routes = up.api().json("GET", "/v1/openapi.json")
    assert routes["paths"]
    assert "places" not in json.dumps(routes["paths"]).replace("decimal places", "")
