"""What the fusion makes of a street whose truth is known."""

import dataclasses

import numpy as np
import pytest

from stitching.made_walls import BUILDING, CAR, PERSON, street_submap, true_east
from submaps.made_submaps import random_submap
from wayloom.config.classes import MOVING_CLASSES, SKY, VOID
from wayloom.stitching.layer_names import MOVING, PARKED, STATIC, UNCONFIRMED
from wayloom.stitching.merge import merge
from wayloom.stitching.points import Box, canonical, map_points, point_covariance
from wayloom.stitching.regions import fuse_region, fused_points, regions_of
from wayloom.stitching.settings import MergeSettings

SETTINGS = MergeSettings()
WHOLE_M = 1e6
EVERYWHERE = Box(*(np.full(2, side * 1e6) for side in (-1, 1, -1, 1)))


def fused_of(placed, options=SETTINGS):
    points = map_points(canonical(placed), EVERYWHERE, options)
    return points, *fused_points(points, options)


def wall_errors(placed):
    points, fused, layer = fused_of(placed)
    wall = points.label == BUILDING
    return np.abs(points.xyz - true_east(placed[0]))[wall, 0], np.abs(fused.xyz - true_east(placed[0]))[wall, 0], layer[wall]


def test_points_of_a_wall_move_onto_it():
    placed = [street_submap(3 * i, drive=f"d{i}") for i in range(4)]
    before, after, layer = wall_errors(placed)
    assert np.median(after[layer == STATIC]) < 0.3 * np.median(before)
    assert np.percentile(after[layer == STATIC], 95) < 0.3 * np.percentile(before, 95)
    assert (layer == STATIC).mean() > 0.95


def test_a_sure_drive_keeps_the_wall_where_it_saw_it():
    """Two drives see a wall 10 cm apart; one knows its place to 2 cm, the other to 20: the wall stays with the first."""
    sure = street_submap(0, drive="sure", sigma_m=(0.03, 0.1))
    shifted = street_submap(3, drive="shifted", sigma_m=(0.03, 0.1))
    shifted.T_enu_submap[0, 3] += 0.1
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.eye(3) * 0.2**2
    shifted = dataclasses.replace(shifted, covariance=covariance)
    points, fused, _ = fused_of([sure, shifted])
    wall = (points.label == BUILDING) & (fused.surface >= 0)
    assert abs(np.median(fused.xyz[wall & (points.drive == 1), 0]) - true_east(sure)) < 0.02


def test_an_unsure_point_that_nothing_confirms_is_kept_out_of_the_published_layer():
    base = street_submap(0)
    lone = dataclasses.replace(
        base.submap,
        xyz=np.array([[6.0, 5.0, 3.0], [6.0, 9.0, 3.0]], np.float32),
        label=np.full(2, BUILDING, np.uint8),
        variance=np.array([0.6**2, 0.1**2], np.float32),
        seen_ns=base.submap.seen_ns[:2],
        keyframe=np.zeros(2, np.uint32),
        vote_start=np.zeros(3, np.uint32),
    )
    one = dataclasses.replace(base, submap=lone, drive_id="a")
    _, _, layer = fused_of([one])
    assert layer.tolist() == [UNCONFIRMED, STATIC]
    _, _, layer = fused_of([one, dataclasses.replace(one, drive_id="b")])
    assert layer.tolist() == [STATIC] * 4
    region = fuse_region(sorted(regions_of(one, SETTINGS, WHOLE_M))[0], [one], SETTINGS, WHOLE_M)
    assert len(region.layers["unconfirmed"]) == 1


def test_a_lone_point_before_a_wall_that_its_ray_meets_waits_for_another_drive():
    base = street_submap(0, 1500)
    xyz, variance, label = base.submap.xyz.copy(), base.submap.variance.copy(), base.submap.label.copy()
    xyz[0], variance[0], label[0] = [9.0, 10.0, 2.0], 0.1**2, BUILDING
    one = dataclasses.replace(base, submap=dataclasses.replace(base.submap, xyz=xyz, variance=variance, label=label), drive_id="a")
    _, fused, layer = fused_of([one])
    assert fused.refuted[0]
    assert layer[0] == UNCONFIRMED
    _, _, layer = fused_of([one, dataclasses.replace(one, drive_id="b")])
    assert layer[0] == STATIC


def test_parked_cars_have_a_layer_and_persons_none():
    placed = [street_submap(seed) for seed in range(3)]
    points, _, layer = fused_of(placed)
    assert PERSON not in points.label
    assert points.left_out["persons"] == sum(int((item.submap.label == PERSON).sum()) for item in placed)
    assert (layer[points.label == CAR] == PARKED).mean() > 0.9
    assert set(layer[points.label == CAR].tolist()) <= {PARKED, MOVING}
    keys = sorted({key for item in placed for key in regions_of(item, SETTINGS)})
    regions = [fuse_region(key, placed, SETTINGS) for key in keys]
    assert sum(int(region.layers["parked"].count.sum()) for region in regions) == int((layer == PARKED).sum())
    assert all(set(region.layers["parked"].label.tolist()) <= {CAR} for region in regions)


def test_a_car_that_passes_is_not_parked():
    base = street_submap(0)
    car = np.flatnonzero(base.submap.label == CAR)
    seen_ns, xyz = base.submap.seen_ns.copy(), base.submap.xyz.copy()
    seconds = (seen_ns - seen_ns.min()) / 1e9
    xyz[car, 1] += (8.0 * seconds[car]).astype(np.float32)
    points, _, layer = fused_of([dataclasses.replace(base, submap=dataclasses.replace(base.submap, xyz=xyz))])
    assert (layer[points.label == CAR] == MOVING).all()


def test_what_is_sky_void_or_a_person_is_left_out_and_counted():
    placed = random_submap(1, 500)
    merged = merge([placed])
    label = placed.submap.label
    assert merged.left_out == {"sky": (label == SKY).sum(), "void": (label == VOID).sum()}
    assert not set(merged.label.tolist()) & {*MOVING_CLASSES, SKY, VOID}


def test_every_point_is_in_one_layer_or_left_out():
    placed = [street_submap(seed) for seed in range(3)]
    region = fuse_region(*_only_region(placed))
    counted = sum(int(layer.count.sum()) for layer in region.layers.values())
    assert counted + sum(region.layers["static"].left_out.values()) == sum(len(item.submap) for item in placed)


def _only_region(placed):
    east, north = np.floor(placed[0].T_enu_submap[:2, 3] / WHOLE_M).astype(int).tolist()
    return (east, north), placed, SETTINGS, WHOLE_M


def voters(labels_and_weights, step_m):
    """Drives with one point each, step_m apart."""
    base = random_submap(0, 1)
    placed = []
    for drive, (label, weight) in enumerate(labels_and_weights):
        submap = dataclasses.replace(
            base.submap,
            xyz=np.array([[step_m * drive, 0.0, 0.0]], np.float32),
            label=np.array([label], np.uint8),
            variance=np.array([0.01], np.float32),
            vote_start=np.array([0, 1], np.uint32),
            vote_class=np.array([label], np.uint8),
            vote_weight=np.array([weight], np.float32),
        )
        placed.append(dataclasses.replace(base, submap=submap, drive_id=f"d{drive}", T_enu_submap=np.eye(4)))
    return placed


def test_drives_that_see_a_place_vote_together():
    """Two say wall with weight 1, one says building with 1.5: the fleet says wall."""
    merged = merge(voters([(3, 1.0), (3, 1.0), (2, 1.5)], 0.0))
    assert merged.label.tolist() == [3]
    assert merged.drives.tolist() == [3]
    assert merged.confidence[0] == pytest.approx(2.0 / 3.5)


def test_drives_outvote_a_voxel_that_they_have_no_point_in():
    """Beside it they weigh a sixteenth each, less by how far off they are."""
    merged = merge(voters([(2, 1.0)] + [(3, 4.0)] * 12, 0.011), MergeSettings(voxel_m=0.01))
    assert len(merged) == 13
    assert set(merged.label.tolist()) == {3}
    assert set(merged.drives.tolist()) == {13}
    alone = merge(voters([(2, 1.0)] + [(3, 1.0)] * 2, 0.011), MergeSettings(voxel_m=0.01))
    assert alone.label.tolist() == [2, 3, 3]


def test_a_certain_point_pulls_the_mean_more_than_an_uncertain_one():
    base = random_submap(0, 2)
    submap = dataclasses.replace(
        base.submap,
        xyz=np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1]], np.float32),
        label=np.zeros(2, np.uint8),
        variance=np.array([0.01, 0.04], np.float32),
        vote_start=np.zeros(3, np.uint32),
    )
    merged = merge(
        [dataclasses.replace(base, submap=submap, T_enu_submap=np.eye(4), covariance=np.zeros((6, 6)))], MergeSettings(voxel_m=0.5)
    )
    assert np.allclose(merged.points_enu, [[0.14, 0.1, 0.1]], atol=0.5 / 4096)


def test_the_poses_covariance_moves_with_the_lever():
    """A turn of sigma 0.01 rad about the origin's up axis moves a point 50 m to the north by 0.5 m to the west or east."""
    covariance = np.zeros((6, 6))
    covariance[5, 5] = 0.01**2
    assert np.allclose(point_covariance(np.array([[0.0, 50.0, 3.0]]), covariance)[0], np.diag([0.25, 0.0, 0.0]))
