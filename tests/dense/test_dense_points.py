"""Dense points of what stands: a made street whose sidewalk is called building, and voxels of made points."""

import numpy as np
import pytest

from made_ground import KERB_AT_M, KERB_M, BuiltUpStreet
from wayloom.config.classes import CLASS_ID
from wayloom.dense.points import VOXEL_M, dense_points, voxels
from wayloom.geometry import se3

BUILDING, POLE = CLASS_ID["building"], CLASS_ID["pole"]


@pytest.fixture(scope="module")
def street():
    return BuiltUpStreet()


def test_points_lie_on_what_stands_and_nowhere_else(street):
    submaps = street.submaps(2)
    found = list(dense_points(street, street.odometry(), street, [item.submap for item in submaps]))
    assert len(found) == 2
    enu = np.concatenate([se3.transform(item.T_enu_submap, one.xyz) for item, one in zip(submaps, found, strict=True)])
    assert len(enu) > 500
    assert (np.concatenate([one.label for one in found]) == BUILDING).all()
    assert np.mean(enu[:, 0] > KERB_AT_M - 0.1) > 0.98
    assert np.median(np.abs(enu[:, 2] - KERB_M)) < 0.03


def test_more_keyframes_that_agree_mean_fewer_points(street):
    submaps = [item.submap for item in street.submaps()]
    counts = [
        sum(len(one.xyz) for one in dense_points(street, street.odometry(), street, submaps, least=least)) for least in (1, 2, 3)
    ]
    assert counts[0] > counts[1] > counts[2] > 0


def test_a_voxel_needs_the_points_of_several_keyframes_not_several_points_of_one():
    near, far = np.full((5, 3), 0.01), np.full((4, 3), 1.01)
    one = (np.vstack([near, far]), np.full(9, BUILDING, np.uint8))
    other = (near[:2] + 0.04, np.array([POLE, BUILDING], np.uint8))
    found = voxels([one, other], 2)
    np.testing.assert_allclose(found.xyz, [[0.01 + 0.04 * 2 / 7] * 3])
    assert (found.label.tolist(), found.keyframes.tolist()) == ([BUILDING], [2])


def test_the_label_of_a_voxel_is_that_of_most_of_its_pixels_and_the_lowest_of_equals():
    points = np.array([[0.0, 0, 0], [0.0, 0, 0], [0.0, 0, 0], [0.5, 0, 0], [0.5, 0, 0]]) + VOXEL_M / 2
    label = np.array([POLE, POLE, BUILDING, POLE, BUILDING], np.uint8)
    assert voxels([(points, label)], 1).label.tolist() == [POLE, min(POLE, BUILDING)]


def test_nothing_seen_gives_no_points():
    assert len(voxels([], 1).xyz) == 0
    assert len(voxels([(np.zeros((0, 3)), np.zeros(0, np.uint8))], 1).label) == 0
