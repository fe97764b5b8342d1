"""The code of docs/python-api.md runs as it stands, on a small simulated drive."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from service_kit.published_tiles import PublishedMap
from service_kit.running import ApiAlone
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python-api.md"
FRAMES = 24
"""Enough for two keyframes, without which there is no map."""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    variant = PresetVariant(drives=("car-1",), frames=FRAMES)
    (folder,) = simulate("demo", tmp_path_factory.mktemp("city"), OutputSettings("quarter"), variant, threads=2)
    return folder


@pytest.fixture
def server_url(tmp_path: Path) -> Iterator[str]:
    """A service with a map of two tiles."""
    alone = ApiAlone(tmp_path / "service")
    city = PublishedMap(alone.data)
    city.publish({("semantic", 3, 4, 2): b"a picture", ("points", 3, 4, 2): b"points"})
    yield alone.url
    city.database.close()
    alone.close()


def test_the_code_of_the_page_runs(drive: Path, server_url: str, tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, object] = {"log_path": drive, "out_dir": tmp_path, "server_url": server_url}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert len(names["points_world"]) > 0  # type: ignore[arg-type]
    assert {tile.layer for tile in names["tiles"]} >= {"points"}  # type: ignore[attr-defined]
    assert (tmp_path / "trajectory.tum").read_text().count("\n") == FRAMES
    assert (tmp_path / "tiles" / "semantic" / "3" / "4" / "2.png").read_bytes() == b"a picture"
    assert not (tmp_path / "tiles" / "points").exists()
