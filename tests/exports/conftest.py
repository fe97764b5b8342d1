"""Drives with ground on disk, for all tests that only read them."""

from pathlib import Path

import pytest

from exports.made_sources import drives_with_ground
from wayloom.exports.drive_outputs import DriveOutputs


@pytest.fixture(scope="session")
def street_folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two drives along one street, as `wayloom process` leaves them."""
    return drives_with_ground(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="session")
def street(street_folders: list[Path]) -> DriveOutputs:
    """The two drives as one map."""
    return DriveOutputs(street_folders)
