"""The service deletes the images of a drive that is in the map, says so, and takes them once more."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit.object_store import WHEREVER, ObjectStoreServer
from service_kit.packed_drives import packed_drive
from service_kit.running import Up, environment, service, until
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.store.drive_files import LOCK
from wayloom.store.receiving.parts import BELOW


def state(up: Up, drive_id: str) -> Any:
    return up.api().drive(drive_id)["images"]["state"]


@pytest.mark.parametrize("wherever", WHEREVER)
def test_images_go_when_the_drive_is_published_and_may_be_sent_once_more(
    tmp_path: Path, object_store: ObjectStoreServer, wherever: str
) -> None:
    packed, url = packed_drive(tmp_path / "drive"), object_store.new_url()
    in_objects = object_store.variables | {"WAYLOOM_UPLOADS__URL": url} if wherever == "objects" else {}
    with service(tmp_path / "data", WAYLOOM_UPLOADS__RETENTION="until-published", **in_objects) as up:
        api = up.api()
        drive_id = upload(api, packed)["id"]
        assert wait_for_drive(api, drive_id)["state"] == "done"
        until(lambda: state(up, drive_id) == "deleted")
        home = up.data / "drives" / drive_id
        assert {path.name for path in home.iterdir()} - {LOCK} == {"stages"}
        until(lambda: not any(object_store.open(url).older_than(0.0, BELOW)))
        assert not {"segmentation", "labelling", "odometry"} & {path.name for path in (home / "stages").iterdir()}
        with httpx2.Client(base_url=up.url, trust_env=False) as http:
            refused = http.post(f"/v1/drives/{drive_id}/reprocess", json={})
        assert (refused.status_code, refused.json()["code"]) == (409, "images-deleted")
        command = [sys.executable, "-m", "wayloom.cli.main", "drives", "show", "drive", "--to", up.url]
        shown = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True).stdout
        assert "images deleted since 20" in shown

        assert upload(api, packed)["missing"] == []
        assert state(up, drive_id) == "deleted"
        upload(api, packed, again=True)
        assert state(up, drive_id) == "kept"
        api.once("POST", f"/v1/drives/{drive_id}/reprocess", json={"labelling": {"reach": 3}})
        until(lambda: api.drive(drive_id)["reprocess"] is None)
        until(lambda: state(up, drive_id) == "deleted")
        assert json.dumps(api.drive(drive_id)["stages"]).count('"done"') == len(api.drive(drive_id)["stages"])
