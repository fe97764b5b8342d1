"""Outputs of drives as one map: the same as merged at once, whatever the order of the folders and the cells that they lie in."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stitching.comparison import assert_identical
from submaps.made_submaps import random_submap
from wayloom.errors import InputError
from wayloom.exports.boxes import inside, parse_box
from wayloom.exports.drive_origin import drive_origin
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.points import map_batches
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.stitching.merge import merge
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import joined_maps
from wayloom.submaps.files import save_submaps
from wayloom.submaps.frames import common_frame, in_frame

ITEMS = [random_submap(0, 300, "a"), random_submap(1, 300, "a"), random_submap(2, 300, "b")]
WEST_CELL, EAST_CELL = MapFrame(8.5, 48.5, 0.0), MapFrame(9.5, 48.5, 0.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("drives")
    save_submaps(ITEMS[:2], root / "one")
    save_submaps(ITEMS[2:], root / "two" / "stages" / "submaps")
    return [root / "one", root / "two"]


def whole(source):
    return joined_maps([part for key in source.keys if (part := source.voxels(key)) is not None], source.frame, source.voxel_m)


def test_region_by_region_is_bit_for_bit_what_is_merged_at_once_in_any_order_of_folders(folders):
    assert_identical(whole(DriveOutputs(folders)), merge(ITEMS))
    assert_identical(whole(DriveOutputs(folders[::-1])), merge(ITEMS))


def test_a_folder_given_twice_counts_once(folders):
    assert_identical(whole(DriveOutputs([*folders, folders[0]])), merge(ITEMS))


def at_cell_border(lon, cell, drive_id, seed):
    """A submap that lies upright at a longitude on the 48.9th parallel, in the frame of a cell."""
    item = random_submap(seed, 200, drive_id)
    local = MapFrame(lon, 48.9, 120.0)
    T = wgs84.T_enu_enu(cell, local) @ se3.from_rotation_translation(item.T_enu_submap[:3, :3], np.zeros(3))
    return replace(item, T_enu_submap=T, frame=cell)


def test_two_drives_across_a_cell_border_are_one_map_in_place(tmp_path):
    """The border runs between them: each is geo-referenced in a frame of its own, and they are exported together."""
    west = [at_cell_border(8.9999, WEST_CELL, "west", seed) for seed in (3, 4)]
    east = [at_cell_border(9.0003, EAST_CELL, "east", 5)]
    for name, items in (("w", west), ("e", east)):
        save_submaps(items, tmp_path / name)
    for order in (["w", "e"], ["e", "w"]):
        source = DriveOutputs([tmp_path / name for name in order])
        assert source.frame == WEST_CELL  # of the most submaps
        found = whole(source)
        assert set(found.drive_ids) == {"west", "east"}
        assert_identical(found, merge([in_frame(item, WEST_CELL) for item in [*west, *east]], MergeSettings()))
    places = np.concatenate([wgs84.lonlatheight_from_enu(item.points_enu(), item.frame) for item in east])
    moved = np.concatenate([wgs84.lonlatheight_from_enu(in_frame(item, WEST_CELL).points_enu(), WEST_CELL) for item in east])
    assert np.abs((places - moved) * [73_000, 111_000, 1]).max() < 1e-6


def test_a_moved_submap_has_the_covariance_of_the_same_place():
    """The covariance of a point does not depend on the frame that it is told in, but for the turn between the two."""
    A = np.random.default_rng(1).normal(size=(6, 6)) * 1e-3
    item = replace(at_cell_border(9.0003, EAST_CELL, "east", 5), covariance=A @ A.T)
    moved = in_frame(item, WEST_CELL)
    R = wgs84.T_enu_enu(WEST_CELL, EAST_CELL)[:3, :3]

    def of_place(one):
        J = np.hstack([np.eye(3), -se3.hat(one.T_enu_submap[:3, 3])])
        return J @ one.covariance @ J.T

    expected = R @ of_place(item) @ R.T
    assert np.abs(of_place(moved) - expected).max() < 1e-9 * np.abs(expected).max() * 1e3
    assert in_frame(item, EAST_CELL) is item


def test_the_frame_of_several_cells_is_that_of_the_most_and_of_equals_the_south_western():
    a, b = MapFrame(8.5, 48.5, 0.0), MapFrame(8.5, 49.5, 0.0)
    assert common_frame([b, a, b]) == b
    assert common_frame([b, a]) == common_frame([a, b]) == a


def test_drives_without_a_place_are_exported_alone_or_not_at_all(tmp_path):
    loose = [replace(random_submap(k, 200, name), frame=None) for k, name in ((1, "a"), (2, "b"))]
    for item in loose:
        save_submaps([item], tmp_path / item.drive_id)
    save_submaps([ITEMS[2]], tmp_path / "placed")
    assert DriveOutputs([tmp_path / "a"]).frame is None
    for names in (("a", "b"), ("a", "placed")):
        with pytest.raises(InputError, match="no place on Earth"):
            DriveOutputs([tmp_path / name for name in names])
    with pytest.raises(InputError, match="leave --bbox away"):
        DriveOutputs([tmp_path / "a"], box=(8.0, 48.0, 9.0, 49.0))


def test_a_box_gives_the_voxels_within_it_and_no_others(folders):
    everything = merge(ITEMS)
    places = wgs84.lonlatheight_from_enu(everything.points_enu, everything.frame)
    low, high = np.percentile(places[:, :2], [35, 70], axis=0)
    box = (*low.tolist(), *high.tolist())
    source = DriveOutputs(folders, box=box)
    found = np.concatenate([batch.points for batch in map_batches(source, box)])
    expected = everything.points_enu[inside(places, box)]
    assert len(found) == len(expected) > 20
    assert np.array_equal(np.unique(found, axis=0), np.unique(expected, axis=0))
    assert set(source.keys) <= set(DriveOutputs(folders).keys)


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d", "8,49,9,48", "8,-95,9,48", "190,48,191,49", "8,48,8,49"])
def test_a_box_that_is_none_is_refused_with_an_example(text):
    with pytest.raises(InputError, match=r"west,south,east,north.*8\.40"):
        parse_box(text)


def test_a_box_across_the_antimeridian_holds_what_lies_on_both_sides():
    box = parse_box("179.5,-1,-179.5,1")
    places = np.array([[179.7, 0.0], [-179.7, 0.0], [179.0, 0.0], [-179.0, 0.0], [180.0, 0.0], [-180.0, 0.5], [179.7, 2.0]])
    assert inside(places, box).tolist() == [True, True, False, False, True, True, False]


def test_the_provenance_names_the_drives_hashes_network_and_code_of_their_stages(tmp_path):
    stages = tmp_path / "drive" / "stages"
    save_submaps(ITEMS[:1], stages / "submaps")
    for name, content in (
        ("ingest/log.json", {"digests": {"images": "1" * 64, "gnss": "2" * 64, "name": "3" * 64}, "log": {"format": "kitti-raw"}}),
        ("segmentation/model.json", {"name": "net", "sha256": "4" * 64, "licence": "MIT", "device": "cpu"}),
        ("submaps/stage.json", {"code": "abc"}),
    ):
        (stages / name).parent.mkdir(parents=True, exist_ok=True)
        (stages / name).write_text(json.dumps(content))
    told = DriveOutputs([tmp_path / "drive"], code="merge 1").provenance()
    (drive,) = told["drives"]
    assert drive["id"] == "a"
    assert drive["sha256"] == {"images": "1" * 64, "gnss": "2" * 64}
    assert drive["network"] == {"name": "net", "sha256": "4" * 64, "licence": "MIT"}
    assert drive["code"] == {"submaps": "abc"}
    assert (told["code"], told["parameters"]["merge"]["voxel_m"]) == ("merge 1", 0.1)
    assert told["frame"] == {"lon_deg": 8.5, "lat_deg": 48.5, "height_m": 0.0}


def test_points_come_of_the_stages_that_lead_to_them_alone(tmp_path):
    """What is written while other stages still run says the same whichever of them is done."""
    for name in ("odometry", "submaps", "looks", "objects"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "stage.json").write_text(json.dumps({"code": name.upper()}))
    assert drive_origin(tmp_path, "a", "submaps")["code"] == {"odometry": "ODOMETRY", "submaps": "SUBMAPS"}
    assert set(drive_origin(tmp_path, "a")["code"]) == {"odometry", "submaps", "looks", "objects"}
