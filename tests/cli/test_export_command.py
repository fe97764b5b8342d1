import subprocess
import sys

import cv2
import laspy
import numpy as np
import pytest

from geodesy.made_geoid import undulation, write_gtx
from submaps.made_submaps import random_submap
from wayloom.config.classes import PALETTE
from wayloom.geodesy import wgs84
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


def test_drives_are_merged_and_written_in_the_format_that_the_name_asks_for(drives, tmp_path):
    out = tmp_path / "map.copc.laz"
    done = export(drives / "one", drives / "two", "--out", out, "--bbox", "-180,-90,180,90")
    assert done.returncode == 0
    assert done.stdout == f"{len(voxels())} points: {out}\n"
    cloud = laspy.read(out)
    assert len(cloud) == len(voxels())
    assert cloud.header.vlrs.get_by_id("copc")


def test_a_picture_shows_an_overview_with_insets_and_says_where_it_came_from(drives, tmp_path):
    done = export(drives / "one", drives / "two", "--out", tmp_path / "city.png")
    assert done.returncode == 0
    assert "2 tracks" in done.stdout
    picture = cv2.imread(str(tmp_path / "city.png"))
    assert picture.shape[1] == 2400
    assert b"wayloom-provenance" in (tmp_path / "city.png").read_bytes()
    labels, counts = np.unique(voxels().label, return_counts=True)
    shown = {label for label, colour in enumerate(PALETTE[:, ::-1]) if (picture == colour).all(axis=2).sum() > 100}
    assert shown >= {*labels[counts > 0.01 * counts.sum()].tolist()}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("NOTHING", "--out", "map.laz"), "holds no submaps"),
        (("ONE", "--from", "http://127.0.0.1:9", "--out", "map.laz"), "--from URL"),
        (("http://127.0.0.1:9", "--out", "map.laz"), "--from URL"),
        (("ONE", "--out", "map.laz", "--bbox", "0,0,1,1"), "there is nothing in the box; give a box that the drives have seen"),
    ],
)
def test_what_cannot_be_exported_is_one_line_with_a_remedy_and_status_2(drives, tmp_path, arguments, said):
    places = {"ONE": drives / "one", "NOTHING": tmp_path, "map.laz": tmp_path / "map.laz"}
    done = export(*(places.get(word, word) for word in arguments))
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert said in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_line_that_names_the_file_and_leaves_nothing(drives, tmp_path):
    """A limit of the size of files answers as a full disk does."""
    limit = "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))"
    run = f"import resource, signal, sys; {limit}; sys.argv[0] = 'wayloom'; from wayloom.cli.main import main; main()"
    out = tmp_path / "map.laz"
    arguments = ["export", str(drives / "one"), "--out", str(out)]
    done = subprocess.run([sys.executable, "-c", run, *arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert str(out) in done.stderr.splitlines()[-1]
    assert [*tmp_path.iterdir()] == []


def test_with_a_geoid_grid_a_laz_states_heights_above_it_and_says_so(drives, tmp_path):
    grid = write_gtx(tmp_path / "grid.gtx")
    done = export(drives / "one", drives / "two", "--out", tmp_path / "map.laz", "--geoid", grid)
    assert done.returncode == 0
    cloud, city = laspy.read(tmp_path / "map.laz"), voxels()
    lon, lat, height = wgs84.lonlatheight_from_enu(city.points_enu, city.frame).T
    assert cloud.header.system_identifier == "orthometric heights"
    truth = np.sort(height - undulation(lon, lat))
    assert np.abs(np.sort(np.array(cloud.z)) - truth).max() < 0.0005 + 2.0**-18  # half a step, and the grid's float32
