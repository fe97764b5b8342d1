"""A few simulated drives that are sent to a service that has no others, through all its stages, again and again."""

import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from wayloom.client.api import AnswerError, Api
from wayloom.client.manifests import PackedDrive, pack
from wayloom.client.selftest.subject import expect
from wayloom.client.upload import upload
from wayloom.config.backoff import Backoff
from wayloom.config.progress import Progress, silent
from wayloom.errors import ServiceError
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate

PRESET: Final = "demo"
FRAMES: Final = 16
LOOK_S: Final = 0.1
PATIENCE_S: Final = 600.0
"""For a drive to end in the map, whatever happens to the service meanwhile."""
RETRIES: Final = Backoff(first_s=0.2, longest_s=3.0, tries=60)
OVER: Final = ("done", "held", "quarantined", "failed")


def small_drives(folder: Path, vehicles: Sequence[str] = ("car-1",), frames: int = FRAMES) -> list[PackedDrive]:
    """Drives of the simulated city of so many frames, in small images; they are drawn where they are not in the folder yet."""
    logs = simulate(PRESET, folder, OutputSettings("quarter"), PresetVariant(drives=tuple(vehicles), frames=frames))
    return [pack(log) for log in logs]


class Trial:
    """The drives on one service: sent, followed, compared with the undisturbed run, and removed again."""

    def __init__(self, url: str, key: str | None, drives: Sequence[PackedDrive]) -> None:
        self.api = Api(url, key, retries=RETRIES)
        self.drives = list(drives)
        self.expected: str | None = None

    @property
    def ids(self) -> list[str]:
        """Of the drives."""
        return [drive.manifest.drive_id for drive in self.drives]

    def close(self) -> None:
        """Close every connection."""
        self.api.close()

    def check_empty(self) -> None:
        """Raise ServiceError where the service has drives: drills are for a service that nobody needs."""
        there = self.api.json("GET", "/v1/drives")["drives"]
        if any(drive["state"] != "removing" for drive in there):
            raise ServiceError(
                f"{self.api.url} has drives: drills kill processes and write into the map, so they want a service of their own"
            )

    def send(self, progress: Progress = silent) -> None:
        """Send every drive."""
        for drive in self.drives:
            upload(self.api, drive, progress)

    def stages(self) -> dict[tuple[str, str], str]:
        """Drive and stage to the stage's state, of drives that are there."""
        rows = [self.api.drive(drive_id) for drive_id in self.ids]
        return {(row["id"], stage["stage"]): stage["state"] for row in rows for stage in row["stages"]}

    def await_stage(self, name: str) -> None:
        """Until a drive has begun this stage, or is over."""
        for _ in _looks(f"stage {name} did not begin"):
            states = {state for (_, stage), state in self.stages().items() if stage == name}
            if states & {"running", "done", "failed"} or self.are_over():
                return

    def are_over(self) -> bool:
        """Whether no drive is on its way any more."""
        return all(self.api.drive(drive_id)["state"] in OVER for drive_id in self.ids)

    def finish(self) -> None:
        """Wait for every drive, and expect that each is in the map, that no stage counts a failure, and that the map is, bit by
        bit, the one of the first run."""
        for _ in _looks("the drives did not come to an end"):
            if self.are_over():
                break
        for drive_id in self.ids:
            row = self.api.drive(drive_id)
            expect(row["state"] == "done", f"{row['name']} ended as {row['state']}: {row['error'] or row['note']}")
            again = {stage["stage"]: stage["attempt"] for stage in row["stages"] if stage["attempt"] != 1}
            expect(not again, f"{row['name']}: attempts were counted: {again}")
        digest = self.map_digest()
        self.expected = self.expected or digest
        expect(digest == self.expected, f"the map has digest {digest[:12]}, that of the undisturbed run is {self.expected[:12]}")

    def forget(self) -> None:
        """Have the drives removed, and wait until the map is without them."""
        for drive_id in self.ids:
            self._removed(drive_id)
        for _ in _looks("the map is not without the drives"):
            if not self._map()["drives"]:
                return

    def _removed(self, drive_id: str) -> None:
        for _ in _looks(f"drive {drive_id[:12]} was not removed"):
            try:
                self.api.json("DELETE", f"/v1/drives/{drive_id}")
            except AnswerError as error:
                if error.status == 404:
                    return
                if error.status != 409:
                    raise

    def _map(self) -> dict[str, Any]:
        name = self.api.json("GET", "/v1/info")["map_id"]
        found: dict[str, Any] = self.api.json("GET", f"/v1/maps/{name}")
        return found

    def map_digest(self) -> str:
        """SHA-256 over the digests of all tiles and regions of the newest version."""
        city = self._map()
        there = []
        for kind in ("", "/regions"):
            address, after = f"/v1/maps/{city['map_id']}/diff/0/{city['version']}{kind}?limit=20000", ""
            while True:
                page = self.api.json("GET", f"{address}{after}")
                there += page["regions" if kind else "added"]
                if page["next"] is None:
                    break
                after = f"&after={page['next']}"
        return hashlib.sha256(json.dumps(there, sort_keys=True).encode()).hexdigest()


def _looks(otherwise: str) -> Any:
    """Look again and again; FailedCheckError after PATIENCE_S."""
    ends = time.monotonic() + PATIENCE_S
    while time.monotonic() < ends:
        yield
        time.sleep(LOOK_S)
    expect(False, f"{otherwise} within {PATIENCE_S:.0f} s")
