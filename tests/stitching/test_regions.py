"""Regions: pure functions of the set of submaps around them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stitching.comparison import assert_identical
from stitching.made_walls import street_submap
from submaps.made_submaps import random_submap
from wayloom.errors import StageError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.merge import merge
from wayloom.stitching.points import canonical
from wayloom.stitching.region_grid import REGION_M, regions_within
from wayloom.stitching.regions import fuse_region, regions_of, whole_map
from wayloom.stitching.settings import MergeSettings

OPTIONS = MergeSettings()
SMALL, WHOLE = 8.0, 1e6
"""Edges of regions, m."""
STREET = [street_submap(seed, 800) for seed in range(6)]


def all_layers(placed, edge_m):
    keys = sorted({key for item in placed for key in regions_of(item, OPTIONS, edge_m)})
    regions = [
        fuse_region(key, [item for item in placed if key in regions_of(item, OPTIONS, edge_m)], OPTIONS, edge_m) for key in keys
    ]
    return [whole_map(regions, placed[0].frame, OPTIONS, layer) for layer in LAYERS]


@given(st.permutations(range(6)))
@settings(max_examples=5, deadline=None)
def test_the_order_of_arrival_changes_no_bit(order):
    assert_identical(merge([STREET[i] for i in order], OPTIONS, SMALL), merge(STREET, OPTIONS, SMALL))


def test_the_union_of_small_regions_is_what_one_great_region_gives():
    small_layers, whole_layers = all_layers(STREET, SMALL), all_layers(STREET, WHOLE)
    assert len(whole_layers[0]) > 1000
    for small, whole in zip(small_layers, whole_layers, strict=True):
        assert_identical(small, whole)


def test_a_map_without_a_drive_is_the_map_that_never_had_it():
    """A region that the drive does not reach is the same to the bit; the others are made anew from the other drives."""
    far = [street_submap(seed, 400, drive="far") for seed in (10, 11)]
    for item in far:
        item.T_enu_submap[1, 3] += 20.0
    others = [item for item in STREET if item.drive_id != "drive-1"]
    keys = {key for item in STREET + far for key in regions_of(item, OPTIONS, SMALL)}
    touched = {key for item in STREET if item.drive_id == "drive-1" for key in regions_of(item, OPTIONS, SMALL)}
    assert touched < keys
    for key in sorted(keys - touched):
        with_it, without = fuse_region(key, STREET + far, OPTIONS, SMALL), fuse_region(key, others + far, OPTIONS, SMALL)
        for layer in LAYERS:
            assert_identical(with_it.layers[layer], without.layers[layer])
    whole, without = merge(STREET + far, OPTIONS, SMALL), merge(others + far, OPTIONS, SMALL)
    assert "drive-1" in whole.drive_ids
    assert "drive-1" not in without.drive_ids
    assert_identical(merge([item for item in (STREET + far)[::-1] if item.drive_id != "drive-1"], OPTIONS, SMALL), without)


def test_a_region_asks_for_no_submap_that_does_not_reach_it():
    for key in sorted({key for item in STREET for key in regions_of(item, OPTIONS, SMALL)})[::3]:
        near = [item for item in STREET if key in regions_of(item, OPTIONS, SMALL)]
        for layer in LAYERS:
            assert_identical(
                fuse_region(key, STREET, OPTIONS, SMALL).layers[layer], fuse_region(key, near, OPTIONS, SMALL).layers[layer]
            )


def test_a_submap_reaches_the_regions_within_the_halo_of_its_points():
    item = random_submap(0, 1)
    p = item.points_enu()[0]
    halo = OPTIONS.halo_m
    expected = {
        (int(np.floor((p[0] + dx) / REGION_M)), int(np.floor((p[1] + dy) / REGION_M)))
        for dx in (-halo, halo)
        for dy in (-halo, halo)
    }
    assert regions_of(item) == expected
    assert expected <= set(regions_within(p[:2], p[:2]))


def test_settings_that_reach_beyond_the_halo_are_refused():
    with pytest.raises(ValueError, match="from 15"):
        MergeSettings(reach_m=5.0)


def test_a_submap_that_comes_twice_counts_once():
    assert_identical(merge(STREET + STREET[::-1], OPTIONS, SMALL), merge(STREET, OPTIONS, SMALL))
    assert len(canonical(STREET + STREET)) == len(STREET)


def test_submaps_of_different_frames_cannot_be_merged():
    other = dataclasses.replace(random_submap(1), frame=MapFrame(9.5, 48.5, 0.0))
    with pytest.raises(StageError, match="one frame"):
        merge([random_submap(0), other])


def test_drives_without_gnss_are_merged_alone():
    one, other = (
        dataclasses.replace(random_submap(i, drive=f"d{i}"), frame=None, covariance=np.full((6, 6), np.nan)) for i in range(2)
    )
    assert merge([one]).frame is None
    assert np.isfinite(merge([one]).points_enu).all()
    with pytest.raises(StageError, match="merge it alone"):
        merge([one, other])


def test_a_submap_beyond_the_grid_is_refused():
    item = random_submap(0)
    item.T_enu_submap[0, 3] = 210_000.0
    with pytest.raises(StageError, match="210 km from its frame's origin"):
        merge([item])


def test_nothing_merges_to_nothing():
    assert len(merge([])) == 0
