"""A stage's code version moves with the code that it imports, and with nothing else."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from wayloom.config.stages import STAGES
from wayloom.errors import StageError
from wayloom.pipeline import code_version as module
from wayloom.pipeline import parsed_source
from wayloom.pipeline.code_version import PACKAGE, code_version, library_versions
from wayloom.pipeline.parsed_source import ParsedSources

READERS = {name: f"wayloom.logs.{name}" for name in ("kitti.kitti_odometry", "kitti.kitti_raw", "kitti.kitti_360", "ros2.mcap_log")}
ROOTS = {stage.name: str(stage.room) for stage in STAGES} | READERS
BEHIND = {"georeference", "submaps"}
TRACKED = {"odometry", "segmentation", "labelling", "places", "looks", "ground", "objects", *BEHIND}
ALL_READERS = set(READERS)
READER_ROOMS = ("wayloom.logs.kitti", "wayloom.logs.ros2")


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package's source."""
    copy = tmp_path_factory.mktemp("source") / "wayloom"
    shutil.copytree(PACKAGE, copy, ignore=lambda _, names: [name for name in names if "." in name and not name.endswith(".py")])
    return copy


@pytest.fixture
def moved_by(package: Path) -> Iterator[Callable[[str, Callable[[str], str]], set[str]]]:
    """Tells which versions move when the text of a file of the copy is changed; the file is put back."""
    files: dict[Path, str] = {}

    def moved(file: str, change: Callable[[str], str]) -> set[str]:
        text = files.setdefault(package / file, (package / file).read_text())
        before = digests(package)
        (package / file).write_text(change(text))
        assert (package / file).read_text() != text
        after = digests(package)
        return {name for name in before if before[name] != after[name]}

    yield moved
    for file, text in files.items():
        file.write_text(text)


def digests(package: Path) -> dict[str, str]:
    """The versions of all stages and readers as their sources are now."""
    module._code_version.cache_clear()
    return {name: code_version(root, package).digest for name, root in ROOTS.items()}


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        ("errors.py", {*ROOTS}),
        ("config/classes.py", {"segmentation", "labelling", "places", "looks", "loops", "ground", "objects", *BEHIND}),
        (
            "config/settings.py",
            {
                "odometry",
                "segmentation",
                "labelling",
                "places",
                "looks",
                "loops",
                "georeference",
                "submaps",
                "ground",
                "objects",
                *ALL_READERS,
            },
        ),
        ("config/stages.py", set()),
        ("config/service.py", set()),
        ("geometry/se3.py", {"ingest", "odometry", "labelling", "places", "loops", "ground", "objects", *BEHIND, *ALL_READERS}),
        ("geodesy/wgs84.py", {"ingest", *BEHIND, *ALL_READERS}),
        ("files/ply.py", {"kitti.kitti_360"}),
        ("logs/inspection.py", {"ingest"}),
        ("logs/registry.py", set()),
        ("logs/drive_writer.py", set()),
        ("logs/kitti/kitti_360_writer.py", set()),
        ("logs/kitti/kitti_360.py", {"kitti.kitti_360"}),
        ("logs/kitti/kitti_odometry.py", {"kitti.kitti_odometry", "kitti.kitti_raw"}),
        ("logs/ros2/cdr.py", {"ros2.mcap_log"}),
        ("logs/images/plain_png.py", {*ALL_READERS, "segmentation", "labelling", "places", "looks", "ground", "objects"}),
        ("odometry/kernels/tracking.py", {"odometry"}),
        ("odometry/result/odometry_file.py", TRACKED),
        ("calibration/learn.py", {"odometry"}),
        ("segmentation/scores.py", {"segmentation", "labelling", "places", "looks", "ground", "objects"}),
        ("segmentation/network.py", {"segmentation"}),
        ("segmentation/download.py", set()),
        ("labelling/kernels/voting.py", {"labelling", "loops"}),
        ("labelling/files.py", {"labelling", "places", *BEHIND}),
        ("places/features.py", {"places"}),
        ("places/stereo_pair.py", {"places", "looks", "ground", "objects"}),
        ("dense/disparity.py", {"looks", "ground"}),
        ("ground/kernels/surface.py", {"ground"}),
        ("ground/exports.py", set()),
        ("places/views.py", {"places", "loops"}),
        ("registration/search.py", {"loops"}),
        ("loops/consistency.py", {"loops"}),
        ("mapping/drive_graph.py", {"georeference"}),
        ("georeference/rigid.py", {"georeference", "submaps"}),
        ("georeference/alignment.py", {"georeference"}),
        ("files/blob.py", {"places", "looks", "loops", "georeference", "submaps", "ground", "objects"}),
        ("objects/kernels/matching.py", {"objects"}),
        ("objects/fusion.py", set()),
        ("tiles/preview.py", {"submaps"}),
        ("tiles/pyramid.py", set()),
        ("stitching/merge.py", set()),
        ("simulation/city/blocks.py", set()),
        ("reports/facts.py", set()),
        ("store/jobs.py", set()),
        ("pipeline/drive.py", set()),
        ("pipeline/exports.py", set()),
        ("pipeline/running.py", set()),
        ("pipeline/log_parts.py", {"ingest"}),
        ("pipeline/stages/labelling.py", {"labelling"}),
        ("__init__.py", set()),
    ],
)
def test_an_edit_moves_the_stages_that_import_the_file_and_no_other(moved_by, file, expected):
    assert moved_by(file, lambda text: text + "\nADDED_LATER = 1\n") == expected


@pytest.mark.parametrize("file", ["odometry/odometry.py", "georeference/rigid.py", "logs/kitti/positioning.py"])
@pytest.mark.parametrize("remark", ["# a remark\n\n\n", '"""Another docstring."""\n'])
def test_a_comment_or_a_docstring_moves_nothing(moved_by, file, remark):
    assert moved_by(file, lambda text: remark + text) == set()


def test_a_comment_in_the_middle_of_a_function_moves_nothing(moved_by):
    assert moved_by("georeference/rigid.py", lambda text: text.replace("    return ", "    # a remark\n\n    return ")) == set()


def test_another_number_moves(moved_by):
    line = "LEAST_KEYFRAMES: Final = 2"
    assert moved_by("pipeline/tracked_drive.py", lambda text: text.replace(line, line + "0")) == TRACKED - {"odometry"}


def test_an_import_within_a_function_counts_and_one_for_types_does_not(package, moved_by):
    moved_by("labelling/neighbours.py", lambda text: text + "\n\ndef late():\n    from wayloom.tiles import png\n")
    assert "wayloom.tiles.png" in code_version("wayloom.pipeline.stages.labelling", package).modules
    typed = "\nfrom typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from wayloom.tiles import png\n"
    moved_by("labelling/neighbours.py", lambda text: text + typed)
    assert "wayloom.tiles.png" not in code_version("wayloom.pipeline.stages.labelling", package).modules


def test_no_stage_imports_a_reader_a_writer_or_the_catalogue():
    for stage in STAGES:
        modules = code_version(str(stage.room)).modules
        assert not [name for name in modules if name.endswith("_writer") or name.startswith(READER_ROOMS)]
        assert not {"wayloom.logs.registry", "wayloom.config.stages", "wayloom.pipeline.running"} & set(modules)


def test_the_libraries_of_a_stage_are_those_that_it_imports(monkeypatch):
    libraries = {stage.name: set(code_version(str(stage.room)).libraries) for stage in STAGES}
    assert {"numpy", "numba", "llvmlite"} <= libraries["odometry"]
    assert {"gtsam", "pyproj", "PROJ", "EPSG", "scipy"} <= libraries["georeference"]
    assert "onnxruntime" in libraries["segmentation"]
    assert "onnxruntime" not in libraries["labelling"] | libraries["odometry"]
    assert "gtsam" not in libraries["odometry"] | libraries["submaps"]
    monkeypatch.setattr(module, "_installed", lambda name: "99" if name == "numba" else None)
    assert library_versions(frozenset({"numba", "json"})) == {"numba": "99"}


def test_a_room_that_is_not_there_is_named():
    with pytest.raises(StageError, match=r"no module wayloom\.pipeline\.stages\.facades"):
        code_version("wayloom.pipeline.stages.facades")


COST = """
import sys, time
from functools import partial
from pathlib import Path
from wayloom.config.stages import STAGES
from wayloom.pipeline import code_version as module
from wayloom.pipeline.parsed_source import ParsedSources
module.code_version("wayloom.pipeline.stages.submaps")  # pyproj is imported, as any run does
module._code_version.cache_clear()
module._sources = partial(ParsedSources, Path(sys.argv[1]))
start = time.process_time()
for stage in STAGES:
    module.code_version(str(stage.room))
print(time.process_time() - start)
"""
"""In a process of its own: threads of other tests would count as well."""


def test_the_versions_of_all_stages_cost_little(tmp_path):
    run = subprocess.run([sys.executable, "-c", COST, str(tmp_path / "sources.json")], check=True, capture_output=True, text=True)
    assert (tmp_path / "sources.json").exists()
    assert float(run.stdout) < 1.5  # 0.4 s on a busy machine, and 0.04 s where the sources were parsed before


def test_versions_from_kept_sources_are_those_of_parsed_ones(monkeypatch, tmp_path):
    versions = []
    for _ in range(2):  # the second time as another process would: all from the file
        sources = ParsedSources(tmp_path / "sources.json")
        monkeypatch.setattr(module, "_sources", lambda sources=sources: sources)
        module._code_version.cache_clear()
        versions.append([code_version(str(stage.room)) for stage in STAGES])
        monkeypatch.setattr(parsed_source, "parsed", None)
    assert versions[0] == versions[1]
