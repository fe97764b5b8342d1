import json
import subprocess
import sys
from dataclasses import replace

import cv2
import laspy
import numpy as np
import pytest

from geodesy.made_geoid import undulation, write_gtx
from ground.made_sheets import Street, cut
from submaps.made_submaps import random_submap
from wayloom.files.ply import read_ply
from wayloom.geodesy import wgs84
from wayloom.ground.files import save_sheets
from wayloom.stitching.merge import merge
from wayloom.submaps.files import save_submaps
from workers.test_ground_of_map import submap_at


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


def test_with_a_geoid_grid_a_laz_states_heights_above_it_and_says_so(drives, tmp_path):
    grid = write_gtx(tmp_path / "grid.gtx")
    done = export(drives / "one", drives / "two", "--out", tmp_path / "map.laz", "--geoid", grid)
    assert (done.returncode, done.stderr) == (0, "")
    cloud, city = laspy.read(tmp_path / "map.laz"), voxels()
    lon, lat, height = wgs84.lonlatheight_from_enu(city.points_enu, city.frame).T
    assert cloud.header.system_identifier == "orthometric heights"
    assert (
        np.abs(np.array(cloud.z) - (height - undulation(lon, lat))).max() < 0.0005 + 2.0**-18
    )  # half a step, and the grid's float32


@pytest.mark.parametrize(("name", "grid", "said"), [("map.laz", "none.gtx", "no such geoid grid"), ("map.ply", "none.gtx", ".laz")])
def test_a_geoid_that_cannot_be_used_is_refused_in_one_line(drives, tmp_path, name, grid, said):
    done = export(drives / "one", "--out", tmp_path / name, "--geoid", tmp_path / grid)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert said in done.stderr
    assert not (tmp_path / name).exists()


def test_a_geojson_holds_the_markings_and_kerbs_of_the_drives_merged_ground(tmp_path):
    folders = []
    for number, start in enumerate((0.0, 30.0)):
        sheet = cut(Street(), start, start + 42.0, "ab"[number] * 64, seed=number, t_s=100 + 900 * number)
        item = submap_at(sheet, number)
        folders.append(tmp_path / f"drive{number}")
        save_submaps([item], folders[-1] / "stages" / "submaps")
        save_sheets([replace(sheet.read(), submap=item.submap.digest)], folders[-1] / "stages" / "ground")
    out = tmp_path / "map.geojson"
    done = export(*folders, "--out", out)
    assert (done.returncode, done.stderr) == (0, "")
    found = [one["properties"]["kind"] for one in json.loads(out.read_text())["features"]]
    assert found.count("dash") == 12  # from 0 to 72 m, one every 6 m
    assert found.count("kerb") >= 2
    assert done.stdout == f"{len(found) - found.count('kerb')} markings and {found.count('kerb')} kerbs of 2 drives: {out}\n"
    back = tmp_path / "back.geojson"
    assert export(*folders[::-1], "--out", back).returncode == 0
    assert back.read_bytes() == out.read_bytes()


def test_markings_of_drives_without_ground_are_refused(drives, tmp_path):
    done = export(drives / "one", "--out", tmp_path / "map.geojson")
    assert done.returncode == 2
    assert "ground" in done.stderr
    assert list(tmp_path.iterdir()) == []
