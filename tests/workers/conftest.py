"""Services without processes, each with a database of its own, on SQLite and on PostgreSQL."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service_kit import postgres
from wayloom.pipeline.settings import WayloomSettings
from wayloom.places.files import encode_places
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.meetings import DriveMeetings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.store.migrate import upgrade
from wayloom.tiles.settings import TileSettings
from wayloom_workers import drive_pairs
from wayloom_workers.__main__ import make_context
from wayloom_workers.stage_hooks import WorkerContext

NewService = Callable[[Path], WorkerContext]
with_finest_tiles = pytest.mark.parametrize("tiles", [TileSettings()], ids=["finest"])
"""For tests of the finest zooms themselves."""
with_one_database = pytest.mark.parametrize("new_service", ["sqlite"], indirect=True)
"""For tests of what is made before it is stored: that both databases hold the same is tested by itself (`test_same_tiles`)."""


@pytest.fixture(scope="session")
def postgres_folder() -> Iterator[str]:
    with postgres.cluster() as folder:
        yield folder


@pytest.fixture
def tiles() -> TileSettings:
    """A zoom less than otherwise: what is shown holds at any, and most of the time goes into the finest pictures."""
    return TileSettings(max_zoom=19, ortho_zoom=19)


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def new_service(request: pytest.FixtureRequest, tiles: TileSettings) -> Iterator[NewService]:
    """Makes an empty service in a folder."""
    made: list[WorkerContext] = []

    def make(folder: Path) -> WorkerContext:
        on_postgres = request.param == "postgresql"
        url = {"database_url": postgres.new_database(request.getfixturevalue("postgres_folder"))} if on_postgres else {}
        made.append(make_context(WayloomSettings(data_dir=folder, tiles=tiles, **url)))
        upgrade(made[-1].database)
        return made[-1]

    yield make
    for service in made:
        service.database.close()


@pytest.fixture
def context(new_service: NewService, tmp_path: Path) -> WorkerContext:
    return new_service(tmp_path / "data")


@pytest.fixture(scope="session")
def known_meetings() -> dict[str, DriveMeetings]:
    return {}


@pytest.fixture(autouse=True)
def registered_once(monkeypatch: pytest.MonkeyPatch, known_meetings: dict[str, DriveMeetings]) -> None:
    """The same two drives are registered once for all tests, whatever the database: that takes seconds."""
    real = drive_pairs.find_meetings

    def find(one: PlacedDrive, other: PlacedDrive, settings: MeetingSettings) -> DriveMeetings:
        key = f"{_digest(one)} {_digest(other)} {settings.model_dump_json()}"
        if key not in known_meetings:
            known_meetings[key] = real(one, other, settings)
        return known_meetings[key]

    monkeypatch.setattr(drive_pairs, "find_meetings", find)


def _digest(drive: PlacedDrive) -> str:
    """Of all that its meetings depend on."""
    parts = [drive.drive_id.encode(), encode_places(drive.places)]
    parts += [item.submap.encoded + item.T_enu_submap.tobytes() + item.covariance.tobytes() for item in drive.submaps]
    return hashlib.sha256(b"".join(parts) + repr(drive.submaps[0].frame).encode()).hexdigest()
