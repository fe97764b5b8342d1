"""What needs an extra that is not installed is refused by one error with one code, wherever it is."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exports.made_sources import made_source
from wayloom.config.extras import EXTRAS, from_extra, remedy_of
from wayloom.errors import MissingExtraError
from wayloom.exports import geoparquet
from wayloom.exports.formats import Export, export_map
from wayloom.exports.points import batch_of_voxels
from wayloom.notebook import frames
from wayloom.segmentation.conversion.convert import convert

ROOT = Path(__file__).parents[2]
OF_DEVELOPERS = {"dev", "train"}


def export(form: str, *layers: str) -> Callable[[Path], object]:
    return lambda out: export_map(Export(made_source(20), out, layers=layers), form)


def table_of_points(_out: Path) -> None:
    voxels = batch_of_voxels(made_source(20).whole)
    frames.of_points(voxels, np.zeros((len(voxels), 3)))


NEEDING: dict[str, tuple[str, Callable[[Path], object]]] = {
    "a network converted": ("convert", lambda out: convert("efficientvit-b0", out.with_suffix(".pt"), out.with_suffix(".onnx"))),
    "features as GeoParquet": ("parquet", export("parquet")),
    "points as GeoParquet": ("parquet", export("parquet", "points")),
    "a recording for Rerun": ("rerun", export("rrd")),
    "features as a GeoDataFrame": ("geo", lambda _: frames.of_features([], {})),
    "points as a GeoDataFrame": ("geo", table_of_points),
}


@pytest.fixture
def without_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("efficientvit", "onnx_writer"):
        monkeypatch.delitem(sys.modules, f"wayloom.segmentation.conversion.{name}", raising=False)
    for name in ("onnx", "geopandas", "rerun"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(geoparquet, "pyarrow", None)


@pytest.mark.usefixtures("without_extras")
@pytest.mark.parametrize("what", NEEDING)
def test_what_needs_an_absent_extra_is_refused_with_one_code_and_leaves_nothing(what: str, tmp_path: Path) -> None:
    extra, use = NEEDING[what]
    with pytest.raises(MissingExtraError, match=re.escape(f"{EXTRAS[extra]}, which is not installed")) as refused:
        use(tmp_path / "out")
    assert (refused.value.reason, refused.value.remedy) == ("extra.missing", f"pip install 'wayloom[{extra}]'")
    assert [*tmp_path.iterdir()] == []


def test_the_table_has_every_extra_of_the_installation() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert set(extras) - OF_DEVELOPERS == set(EXTRAS)
    for name, brings in EXTRAS.items():
        assert [re.split("[<>=]", one)[0] for one in extras[name]] == brings.split(" and ")


def test_the_command_that_installs_an_extra_is_written_in_one_place() -> None:
    files = [file for room in ("core", "services", "workers") for file in (ROOT / room).rglob("*.py")]
    assert [file.name for file in files if "wayloom[" in file.read_text(encoding="utf-8")] == ["extras.py"]
    assert remedy_of("geo") in (ROOT / "docs/python-api.md").read_text(encoding="utf-8")


def test_a_module_of_our_own_that_is_absent_is_no_absent_extra() -> None:
    with pytest.raises(ModuleNotFoundError), from_extra("geo", "a made thing"):
        import wayloom.nowhere  # type: ignore[import-not-found]  # noqa: F401


def test_a_command_ends_with_status_2_and_one_line_with_the_code_and_the_remedy(tmp_path: Path) -> None:
    run = "import sys; sys.modules['onnx'] = None; sys.argv[0] = 'wayloom'; from wayloom.cli.main import main; main()"
    arguments = ["models", "convert", "efficientvit-b0", str(tmp_path / "vit.pt"), "--out", str(tmp_path / "vit.onnx")]
    done = subprocess.run([sys.executable, "-c", run, *arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        "wayloom: the conversion of a network needs onnx, which is not installed; pip install 'wayloom[convert]' [extra.missing]\n"
    )
