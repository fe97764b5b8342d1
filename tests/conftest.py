"""Fixtures that every room's tests share: where the real recordings and networks lie."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from service_kit.object_store import ObjectStoreServer
from wayloom.logs.registry import open_log
from wayloom.odometry.odometry import track
from wayloom.odometry.types import OdometryResult

ROOT = Path(__file__).resolve().parents[1]


def _folder(variable: str, default: str) -> Path:
    """The folder that the variable names. Missing is a failure in CI and a skip, with the reason, elsewhere."""
    folder = Path(os.environ.get(variable, ROOT / default))
    if not folder.is_dir():
        message = f"{variable}: no folder {folder}; set the variable to the folder that holds them"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return folder


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The real recordings (README of that folder says what is in it)."""
    return _folder("WAYLOOM_DATA", "../shared/data")


@pytest.fixture(scope="session")
def models_dir() -> Path:
    """Foreign networks."""
    return _folder("WAYLOOM_MODELS", "../shared/models")


@pytest.fixture(scope="session")
def object_store() -> Iterator[ObjectStoreServer]:
    """An S3 server for the tests' uploads."""
    server = ObjectStoreServer()
    yield server
    server.close()


@pytest.fixture(scope="session")
def clip_a(data_dir: Path) -> Path:
    """201 grey stereo pairs in KITTI odometry layout."""
    return data_dir / "kitti_odometry" / "sequences" / "00"


@pytest.fixture(scope="session")
def clip_b(data_dir: Path) -> Path:
    """154 colour stereo pairs in KITTI raw (sync) layout, JPEG."""
    return data_dir / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync"


@pytest.fixture(scope="session")
def clip_a_gnss(data_dir: Path) -> Path:
    """The GNSS/INS log of the whole drive of which clip A is the first 201 frames."""
    return data_dir / "kitti_oxts" / "2011_10_03" / "2011_10_03_drive_0027_sync"


@pytest.fixture(scope="session")
def tracked_clip_a(clip_a: Path) -> OdometryResult:
    """Clip A's odometry: tests read it, none changes it."""
    return track(open_log(clip_a))


@pytest.fixture(scope="session")
def tracked_clip_b(clip_b: Path) -> OdometryResult:
    """Clip B's odometry: tests read it, none changes it."""
    return track(open_log(clip_b))
