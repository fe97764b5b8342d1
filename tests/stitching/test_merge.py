import dataclasses
from collections import defaultdict
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from submaps.made_submaps import random_submap
from wayloom.config.classes import MOVING_CLASSES, SKY, VOID
from wayloom.errors import StageError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.merge import MAX_WEIGHT, OFFSET_STEPS, STATIC_CLASSES, VOTE_STEPS, WEIGHT_STEPS, merge, pack, unpack
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import VoxelMap

pytestmark = pytest.mark.kernels

COARSE = MergeSettings(voxel_m=0.5)
FIELDS = ("keys", "points_enu", "votes", "label", "count", "drives", "last_seen_ns")


def assert_identical(one: VoxelMap, other: VoxelMap) -> None:
    assert (one.frame, one.voxel_m, one.left_out) == (other.frame, other.voxel_m, other.left_out)
    for name in FIELDS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes(), name


def naive(placed, voxel_m):
    """The definition, point by point, in exact fractions."""
    voxels = defaultdict(lambda: {"w": 0, "p": [Fraction(0)] * 3, "votes": [0] * 19, "n": 0, "drives": set(), "seen": 0})
    for item in placed:
        s = item.submap
        for i, p in enumerate(item.points_enu()):
            if s.label[i] == VOID or s.label[i] == SKY or s.label[i] in MOVING_CLASSES:
                continue
            key = tuple(int(np.floor(c / voxel_m)) for c in p)
            v = voxels[key]
            w = int(np.clip(np.rint(WEIGHT_STEPS / float(s.variance[i])), 1, MAX_WEIGHT))
            v["w"] += w
            for axis in range(3):
                step = min(int(np.floor((p[axis] / voxel_m - key[axis]) * OFFSET_STEPS)), OFFSET_STEPS - 1)
                v["p"][axis] += w * Fraction(2 * step + 1, 2 * OFFSET_STEPS)
            rows = range(s.vote_start[i], s.vote_start[i + 1])
            for k in rows:
                v["votes"][s.vote_class[k]] += max(int(np.rint(float(s.vote_weight[k]) * VOTE_STEPS)), 1)
            if not len(rows):
                v["votes"][s.label[i]] += 1
            v["n"] += 1
            v["drives"].add(item.drive_id)
            v["seen"] = max(v["seen"], int(s.seen_ns[i]))
    return voxels


def test_merging_is_what_its_naive_twin_says():
    placed = [random_submap(seed, 150) for seed in range(4)]
    merged, twin = merge(placed, COARSE), naive(placed, 0.5)
    assert [tuple(k) for k in merged.keys.tolist()] == sorted(twin)
    for i, key in enumerate(sorted(twin)):
        v = twin[key]
        expected = [0.5 * (key[axis] + float(v["p"][axis] / v["w"])) for axis in range(3)]
        assert np.allclose(merged.points_enu[i], expected, atol=1e-9)
        assert np.allclose(merged.votes[i], np.array(v["votes"]) / VOTE_STEPS, rtol=1e-6)
        assert merged.label[i] == max(STATIC_CLASSES.tolist(), key=lambda c: (v["votes"][c], -c))
        assert merged.count[i] == v["n"]
        assert merged.drives[i] == len(v["drives"])
        assert merged.last_seen_ns[i] == v["seen"]


@given(st.permutations(range(20)))
@settings(max_examples=15, deadline=None)
def test_the_order_of_arrival_changes_no_bit(order):
    placed = [random_submap(seed, 60) for seed in range(20)]
    assert_identical(merge([placed[i] for i in order], COARSE), merge(placed, COARSE))


def test_a_map_without_a_drive_is_the_map_that_never_had_it():
    """Voxels that no point of the drive fell into are the same to the bit with and without it; the others change, or vanish."""
    placed = [random_submap(seed, 60, drive=f"drive-{seed // 3}") for seed in range(9)]
    others = [p for p in placed if p.drive_id != "drive-1"]
    whole, without = merge(placed, COARSE), merge(others, COARSE)
    own = {tuple(key) for p in placed if p.drive_id == "drive-1" for key in merge([p], COARSE).keys.tolist()}
    shared = own & {tuple(key) for key in without.keys.tolist()}
    assert 0 < len(shared) < len(own)
    untouched = np.array([tuple(key) not in own for key in whole.keys.tolist()])
    kept = np.array([tuple(key) not in own for key in without.keys.tolist()])
    for name in FIELDS:
        assert getattr(whole, name)[untouched].tobytes() == getattr(without, name)[kept].tobytes(), name
    assert set(map(tuple, whole.keys[~untouched].tolist())) == own
    drives = dict(zip(map(tuple, whole.keys.tolist()), whole.drives.tolist(), strict=True))
    assert all(drives[tuple(key)] == n + 1 for key, n in zip(without.keys[~kept].tolist(), without.drives[~kept], strict=True))


def test_a_submap_that_comes_twice_counts_once():
    placed = [random_submap(seed) for seed in range(3)]
    assert_identical(merge(placed + placed[::-1], COARSE), merge(placed, COARSE))


def test_what_moves_the_sky_and_void_stay_out_and_are_counted():
    placed = random_submap(1, 500)
    merged = merge([placed])
    label = placed.submap.label
    assert merged.left_out == {"moving": (label == 13).sum(), "sky": (label == SKY).sum(), "void": (label == VOID).sum()}
    assert merged.count.sum() == 500 - sum(merged.left_out.values())
    assert not set(merged.label.tolist()) & {*MOVING_CLASSES, SKY, VOID}


def test_drives_that_see_a_place_vote_together():
    """Two say wall with weight 1, one says building with 1.5: the fleet says wall."""
    base = random_submap(0, 1)
    placed = []
    for drive, (label, weight) in enumerate([(3, 1.0), (3, 1.0), (2, 1.5)]):
        submap = dataclasses.replace(
            base.submap,
            label=np.array([label], np.uint8),
            vote_start=np.array([0, 1], np.uint32),
            vote_class=np.array([label], np.uint8),
            vote_weight=np.array([weight], np.float32),
        )
        placed.append(dataclasses.replace(base, submap=submap, drive_id=f"d{drive}"))
    merged = merge(placed)
    assert merged.label.tolist() == [3]
    assert merged.drives.tolist() == [3]
    assert merged.confidence[0] == pytest.approx(2.0 / 3.5)


def test_a_certain_point_pulls_the_mean_more_than_an_uncertain_one():
    base = random_submap(0, 2)
    submap = dataclasses.replace(
        base.submap,
        xyz=np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1]], np.float32),
        label=np.zeros(2, np.uint8),
        variance=np.array([0.01, 0.04], np.float32),
        vote_start=np.zeros(3, np.uint32),
    )
    merged = merge([dataclasses.replace(base, submap=submap, T_enu_submap=np.eye(4))], COARSE)
    assert np.allclose(merged.points_enu, [[0.14, 0.1, 0.1]], atol=0.5 / OFFSET_STEPS)


def test_submaps_of_different_frames_cannot_be_merged():
    other = dataclasses.replace(random_submap(1), frame=MapFrame(9.5, 48.5, 0.0))
    with pytest.raises(StageError, match="one frame"):
        merge([random_submap(0), other])


def test_drives_without_gnss_are_merged_alone():
    one, other = (dataclasses.replace(random_submap(i, drive=f"d{i}"), frame=None) for i in range(2))
    assert merge([one]).frame is None
    with pytest.raises(StageError, match="merge it alone"):
        merge([one, other])


def test_a_submap_beyond_the_grid_is_refused():
    item = random_submap(0)
    item.T_enu_submap[0, 3] = 210_000.0
    with pytest.raises(StageError, match="210 km from its frame's origin"):
        merge([item])


def test_nothing_merges_to_nothing():
    assert len(merge([])) == 0


def test_packed_keys_sort_as_the_keys_do_and_come_back():
    rng = np.random.default_rng(0)
    keys = rng.integers(-(2**18), 2**18, (1000, 3)) * [8, 8, 1]
    packed = pack(keys)
    assert np.array_equal(unpack(packed), keys)
    assert np.array_equal(np.argsort(packed), np.lexsort((keys[:, 2], keys[:, 1], keys[:, 0])))
