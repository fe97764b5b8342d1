import subprocess
import sys

import cv2
import laspy
import pytest

from submaps.made_submaps import random_submap
from wayloom.files.ply import read_ply
from wayloom.stitching.merge import merge
from wayloom.submaps.files import save_submaps


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Two folders: one as the stage writes it, one as `wayloom process` keeps it."""
    root = tmp_path_factory.mktemp("drives")
    save_submaps([random_submap(0, 300, "a"), random_submap(1, 300, "a")], root / "one")
    save_submaps([random_submap(2, 300, "b")], root / "two" / "stages" / "submaps")
    return root


def export(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "wayloom.cli.main", "export", *map(str, arguments)], capture_output=True, text=True
    )


def voxels():
    return merge([random_submap(0, 300, "a"), random_submap(1, 300, "a"), random_submap(2, 300, "b")])


@pytest.mark.parametrize("suffix", ["laz", "ply", "png"])
def test_drives_are_merged_and_written_in_the_format_that_the_name_asks_for(drives, tmp_path, suffix):
    out = tmp_path / f"map.{suffix}"
    done = export(drives / "one", drives / "two", "--out", out)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{len(voxels())} voxels of 3 submaps and 2 drives: {out}\n"
    if suffix == "laz":
        assert len(laspy.read(out)) == len(voxels())
    elif suffix == "ply":
        assert len(read_ply(out).labels) == len(voxels())
    else:
        assert cv2.imread(str(out)) is not None


def test_a_name_without_suffix_is_a_folder_of_tiles(drives, tmp_path):
    done = export(drives / "one", "--out", tmp_path / "tiles")
    assert done.returncode == 0
    assert {p.name for p in (tmp_path / "tiles").iterdir()} == {"semantic", "features", "points"}
    assert {p.suffix for p in (tmp_path / "tiles").rglob("*.*")} == {".png", ".mvt", ".wlp"}


def test_folders_without_submaps_and_unknown_formats_are_one_line_and_status_2(drives, tmp_path):
    for arguments, said in (
        ((tmp_path, "--out", tmp_path / "map.laz"), "holds no submaps"),
        ((drives / "one", "--out", tmp_path / "map.docx"), ".docx is no format"),
    ):
        done = export(*arguments)
        assert done.returncode == 2
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
        assert list(tmp_path.iterdir()) == []
