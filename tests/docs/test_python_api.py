"""The code of docs/python-api.md runs as it stands, on a small simulated drive."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import wayloom
from exports.made_sources import drives_with_ground
from service_kit.published_regions import publish_drives
from service_kit.running import ApiAlone
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python-api.md"
FRAMES = 24
"""Enough for two keyframes, without which there is no map."""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    variant = PresetVariant(drives=("car-1",), frames=FRAMES)
    (folder,) = simulate("demo", tmp_path_factory.mktemp("city"), OutputSettings("quarter"), variant, threads=2)
    return folder


@pytest.fixture(scope="module")
def server_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service with a map of two made drives."""
    alone = ApiAlone(tmp_path_factory.mktemp("service"))
    publish_drives(alone.data, DriveOutputs(drives_with_ground(tmp_path_factory.mktemp("street"))))
    yield alone.url
    alone.close()


def test_the_code_of_the_page_runs(drive: Path, server_url: str, tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, object] = {"log_path": drive, "out_dir": tmp_path, "server_url": server_url}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert len(names["points_world"]) > 0  # type: ignore[arg-type]
    assert {tile.layer for tile in names["tiles"]} >= {"points"}  # type: ignore[attr-defined]
    assert len(names["heights"]) == FRAMES  # type: ignore[arg-type]
    assert np.isfinite(names["heights"]).any()  # type: ignore[call-overload]
    assert (tmp_path / "trajectory.tum").read_text().count("\n") == FRAMES
    assert (tmp_path / "city.gpkg").stat().st_size > 0
    assert [*(tmp_path / "tiles" / "points").glob("*/*/*")]


def test_the_page_names_every_door() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [door for door in wayloom._DOORS if f"`wayloom.{door}(" not in text] == []
