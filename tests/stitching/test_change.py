"""What has gone leaves the map, what is new comes when it is confirmed, and nothing true is removed."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from stitching.comparison import assert_identical
from stitching.made_sights import CAMERA, POLE, POLE_M, POLE_NORTH, Passing, driven, seen
from wayloom.config.classes import CLASS_ID
from wayloom.dense.types import BUILT, DEPTHS_M, GREEN, MOVING, THIN
from wayloom.geometry import se3
from wayloom.stitching.evidence import WEIGHTS, log_odds
from wayloom.stitching.kernels import sight
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.merge import merge
from wayloom.stitching.placed_looks import canonical_looks
from wayloom.stitching.region_files import decode_region, encode_region
from wayloom.stitching.regions import fuse_region, regions_of, regions_seen
from wayloom.stitching.settings import LOOK_HALO_M, ChangeSettings, MergeSettings
from wayloom.stitching.sightings import INVERSE_DEPTHS, Sightings
from wayloom.stitching.things import find_things

OPTIONS = MergeSettings()
WHOLE = 1e6
CAR, LEAVES = CLASS_ID["car"], CLASS_ID["vegetation"]
STANDS, IS_GONE = Passing(0), Passing(1, pole=False)


def mapped(*ways, edge_m=WHOLE, looks=None):
    """The region that holds all, and its changes."""
    placed = [driven(way) for way in ways]
    return fuse_region((0, 0), placed, OPTIONS, edge_m, [seen(way) for way in ways] if looks is None else looks)


def poles(region, layer="static"):
    return int((region.layers[layer].label == POLE).sum())


def test_what_a_later_drive_sees_through_is_gone_with_both_sides_as_evidence():
    region = mapped(STANDS, IS_GONE)
    assert poles(mapped(STANDS)) == 6
    assert poles(region) == 0
    assert poles(region, "gone") == 6
    (change,) = region.changes
    assert (change.kind, change.label, change.seen_by, change.through_by) == ("gone", POLE, ("day-0",), ("day-1",))
    np.testing.assert_allclose(change.position_enu[:2], (POLE_M, POLE_NORTH), atol=0.05)
    assert change.extent_m[2] == pytest.approx(2.0, abs=0.01)
    assert change.through >= 4
    assert change.last_seen_ns < change.first_through_ns


def test_what_has_a_single_point_leaves_the_map_and_is_not_listed():
    region = mapped(Passing(0, points=1, label=LEAVES), IS_GONE)
    assert [int((region.layers[layer].label == LEAVES).sum()) for layer in ("static", "gone")] == [0, 1]
    assert region.changes == ()
    region = mapped(Passing(0, pole=False), Passing(1, points=1, label=LEAVES))
    assert (int((region.layers["static"].label == LEAVES).sum()), region.changes) == (1, ())


@pytest.mark.parametrize(
    "stood",
    [
        pytest.param([Passing(0, points=2, label=LEAVES)], id="of one drive"),
        pytest.param([Passing(0, points=1, label=LEAVES), Passing(1, points=1, label=LEAVES)], id="of two drives"),
    ],
)
def test_what_has_two_points_is_listed(stood):
    (change,) = mapped(*stood, Passing(2, pole=False)).changes
    assert (change.kind, change.label, change.points) == ("gone", LEAVES, 2)


def test_a_post_of_a_single_point_is_listed_gone_and_new():
    (gone,) = mapped(Passing(0, points=1), IS_GONE).changes
    (new,) = mapped(Passing(0, pole=False), Passing(1, points=1)).changes
    assert [(one.kind, one.label, one.points) for one in (gone, new)] == [("gone", POLE, 1), ("new", POLE, 1)]


def test_the_wall_behind_loses_nothing():
    region, before = mapped(STANDS, IS_GONE), mapped(STANDS, IS_GONE, looks=[])
    walls = [(one.layers["static"].label != POLE).sum() for one in (region, before)]
    assert walls[0] == walls[1]


def test_what_earlier_drives_saw_through_is_new_once_it_is_confirmed():
    region = mapped(Passing(0, pole=False), Passing(1))
    (change,) = region.changes
    assert (change.kind, change.seen_by, change.through_by) == ("new", ("day-1",), ("day-0",))
    assert poles(region) == 6


def test_what_one_drive_has_in_few_looks_where_others_saw_through_waits_for_a_second_drive():
    few = Passing(1, north=(6.0, 8.0, 10.0, 12.0))
    region = mapped(Passing(0, pole=False), few)
    assert region.changes == ()
    assert (poles(region), poles(region, "unconfirmed")) == (0, 6)
    region = mapped(Passing(0, pole=False), few, replace(few, day=2))
    assert [change.kind for change in region.changes] == ["new"]
    assert poles(region) > 0


@pytest.mark.parametrize(
    "later",
    [
        pytest.param(Passing(1), id="a drive that sees it"),
        pytest.param(Passing(1, pole=False, labelled=True), id="a drive whose stereo misses what its labels show"),
        pytest.param(Passing(1, pole=False, hidden=True), id="a drive that is kept from seeing it"),
        pytest.param(Passing(1, pole=False, has_points=True), id="a drive that has points of it"),
        pytest.param(Passing(1, pole=False, sigma_m=1.0), id="a drive that does not know where it is"),
        pytest.param(Passing(1, pole=False, north=(9.0, 11.0)), id="a drive with too few looks"),
        pytest.param(Passing(1, pole=False, north=(6.0, 8.0, 12.0)), id="a drive that looks three times"),
        pytest.param(Passing(1, pole=False, place=(0.0, 60.0)), id="a drive that looks elsewhere"),
    ],
)
def test_what_stands_stays_in_the_map(later):
    region = mapped(STANDS, later)
    assert region.changes == ()
    assert poles(region) >= 6 - 1
    assert poles(region, "gone") == 0


SHORT = Passing(1, pole=False, north=(9.0, 11.0))


def test_looks_of_two_drives_together_say_what_those_of_one_are_too_few_for():
    assert mapped(STANDS, SHORT).changes == ()
    (change,) = mapped(STANDS, SHORT, replace(SHORT, day=2)).changes
    assert (change.kind, change.through_by, change.through) == ("gone", ("day-1", "day-2"), 4)


def test_a_drive_that_sees_it_speaks_against_those_that_see_through():
    through, stands = replace(SHORT, north=(8.0, 9.0, 10.0, 11.0)), Passing(2, north=(9.0, 11.0), has_points=False)
    assert [one.kind for one in mapped(STANDS, through, stands).changes] == ["gone"]
    assert mapped(STANDS, through, replace(stands, north=(9.0, 10.0, 11.0))).changes == ()


def test_a_drive_whose_looks_deny_each_other_leaves_it_to_the_next():
    unsure = (
        Passing(1, pole=False, north=(8.0, 9.0, 10.0, 11.0)),
        Passing(1, has_points=False, north=(8.5, 9.5, 10.5, 11.5)),
    )
    assert mapped(STANDS, *unsure).changes == ()
    (change,) = mapped(STANDS, *unsure, replace(SHORT, day=2)).changes
    assert (change.kind, change.through_by, change.through) == ("gone", ("day-1", "day-2"), 6)


def recast(item, kinds):
    """Looks with kinds exchanged."""
    table = np.arange(256, dtype=np.uint8)
    table[list(kinds)] = list(kinds.values())
    return replace(item, looks=replace(item.looks, kinds=table[item.looks.kinds]))


def parked(way):
    """The drive with a car in the pole's place, that stands while it is seen."""
    item = driven(way)
    submap = item.submap
    label = np.where(submap.label == POLE, CAR, submap.label).astype(np.uint8)
    return replace(item, submap=replace(submap, label=label, seen_ns=submap.seen_ns + np.arange(len(label)) * 10**9))


def test_past_where_a_car_stood_to_another_car_is_through():
    looks = [recast(seen(STANDS), {THIN: MOVING}), recast(seen(IS_GONE), {BUILT: MOVING})]
    region = fuse_region((0, 0), [parked(STANDS), parked(IS_GONE)], OPTIONS, WHOLE, looks)
    assert [(one.kind, one.label) for one in region.changes] == [("gone", CAR)]
    assert (len(region.layers["parked"]), len(region.layers["gone"])) == (0, 6)


def test_past_a_pole_to_another_pole_is_not_through_as_stereo_misses_poles():
    assert mapped(STANDS, IS_GONE, looks=[seen(STANDS), recast(seen(IS_GONE), {BUILT: THIN})]).changes == ()


def test_a_pole_whose_own_stereo_misses_it_agrees_by_no_look_and_is_never_missed():
    assert mapped(Passing(0, pole=False, labelled=True, has_points=True), IS_GONE).changes == ()


def test_what_its_own_drive_hardly_saw_stays():
    glimpse = Passing(0, north=(9.0, 11.0))
    assert mapped(glimpse, IS_GONE).changes == ()
    assert poles(mapped(glimpse, IS_GONE)) == 6


def test_what_its_own_drive_sees_through_is_no_thing_and_stays():
    assert mapped(Passing(0, pole=False, has_points=True), IS_GONE).changes == ()
    assert poles(mapped(Passing(0, pole=False, has_points=True), IS_GONE)) == 6


def test_what_comes_back_is_in_the_map():
    region = mapped(STANDS, IS_GONE, Passing(2))
    assert region.changes == ()
    assert poles(region) > 0


def test_what_came_and_went_is_listed_as_gone():
    (change,) = mapped(Passing(0, pole=False), Passing(1), Passing(2, pole=False)).changes
    assert (change.kind, change.seen_by, change.through_by) == ("gone", ("day-1",), ("day-2",))


def test_a_drive_alone_loses_nothing():
    alone, without = mapped(STANDS), mapped(STANDS, looks=[])
    for layer in LAYERS:
        assert_identical(alone.layers[layer], without.layers[layer])


def test_a_drive_without_looks_is_merged_as_ever():
    region = mapped(STANDS, IS_GONE, looks=[seen(STANDS)])
    assert poles(region) == 6
    assert region.changes == ()


SCENE = (STANDS, IS_GONE, Passing(2, pole=False), Passing(3, place=(3.0, 30.0)), Passing(4, pole=False, place=(3.0, 30.0)))


def test_neither_order_nor_repetition_changes_a_bit():
    first = mapped(*SCENE)
    assert len(first.changes) == 2
    for order in itertools.islice(itertools.permutations(SCENE), 7, 120, 37):
        other = mapped(*order, order[0])
        assert other.changes == first.changes
        for layer in LAYERS:
            assert_identical(other.layers[layer], first.layers[layer])


def test_small_regions_with_what_bears_on_them_give_what_one_great_region_gives():
    placed, looks = [driven(way) for way in SCENE], [seen(way) for way in SCENE]
    found = []
    for key in sorted(set().union(*(regions_of(item, OPTIONS, 8.0) for item in placed))):
        near = [item for item in placed if key in regions_of(item, OPTIONS, 8.0)]
        found += fuse_region(key, near, OPTIONS, 8.0, [one for one in looks if key in regions_seen(one, 8.0)]).changes
    assert sorted(found, key=lambda one: one.position_enu) == list(mapped(*SCENE).changes)
    assert_identical(merge(placed, OPTIONS, 8.0, looks), merge(placed, OPTIONS, WHOLE, looks))


def test_looks_bear_on_regions_up_to_their_halo():
    one = seen(Passing(0, north=(0.0,)))
    assert regions_seen(one, 16.0) == {(i, j) for i in range(-2, 2) for j in range(-2, 2)}
    assert len(canonical_looks([one, one], np.zeros(2), np.ones(2), 5.0)) == 1
    assert canonical_looks([one], np.full(2, LOOK_HALO_M), np.full(2, 99.0), 5.0) == []


def test_a_region_file_keeps_its_changes():
    region = mapped(STANDS, IS_GONE)
    frame = driven(STANDS).frame
    again = decode_region(encode_region(region, frame))
    assert again.changes == region.changes
    assert_identical(again.layers["gone"], region.layers["gone"])


def test_points_in_columns_that_touch_are_one_thing_and_large_ones_are_cut():
    hedge = np.column_stack([0.4 * np.arange(30), np.full(30, 20.0), np.zeros(30)])
    xyz = np.concatenate([[[0.1, 0.1, 0.0], [0.6, 0.6, 9.0], [1.6, 0.1, 0.0]], hedge])
    label = np.repeat(np.array([5, 8], np.uint8), [3, 30])
    things = find_things(xyz, label, np.arange(33), 0.5, 6.0)
    members = sorted(things.rows[a:b].tolist() for a, b in itertools.pairwise(things.start.tolist()))
    assert members[:2] == [[0, 1], [2]]
    assert len(members) == 2 + 6
    assert max(np.ptp(xyz[rows, 0]) for rows in members) <= 2.0
    assert things.kind[things.label == 5].tolist() == [THIN, THIN]


def test_kinds_that_touch_are_things_of_their_own_and_ground_is_none():
    things = find_things(np.zeros((4, 3)), np.array([6, 7, 8, 0], np.uint8), np.arange(4), 0.5, 6.0)
    assert sorted(things.rows[a:b].tolist() for a, b in itertools.pairwise(things.start.tolist())) == [[0, 1], [2]]


def test_a_sign_beside_a_lamp_is_a_thing_of_its_own():
    xyz = np.array([[0.1, 0.1, 2.0], [0.2, 0.1, 2.2], [0.6, 0.1, 1.0]])
    things = find_things(xyz, np.array([7, 7, 5], np.uint8), np.arange(3), 0.5, 6.0)
    assert sorted(things.rows[a:b].tolist() for a, b in itertools.pairwise(things.start.tolist())) == [[0, 1], [2]]
    assert things.kind.tolist() == [THIN, THIN]


def test_log_odds_add_what_each_word_weighs():
    rng = np.random.default_rng(5)
    through, bare, seen = rng.integers(0, 9, (3, 2, 4))
    kind = np.array([THIN, MOVING, GREEN, BUILT], np.uint8)
    none = np.zeros((2, 4), np.int64)
    odds = log_odds(Sightings(("a", "b"), seen, through, bare, none, none, none, none), kind)
    for (drive, thing), value in np.ndenumerate(odds):
        words = np.array([through[drive, thing], bare[drive, thing], seen[drive, thing]])
        assert value == pytest.approx(float(words @ np.array(WEIGHTS[int(kind[thing])])))


def test_no_points_are_no_things():
    assert len(find_things(np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros(0, np.int64), 0.5, 6.0)) == 0


def naive_word(point, variance, kinds, look, n, limits):
    """Twin of the kernel for one point and one look."""
    furthest, gate, slack_m, sigma = limits
    x, y, z = se3.transform(se3.inverse(look.T_map_cam[n]), point[None])[0]
    spread = gate * np.sqrt(variance + look.variance[n])
    radius = spread * CAMERA.fx / z if z > 0 else np.inf
    if not (sight.NEAREST_M <= z <= furthest) or x * x + y * y + z * z > furthest**2 or radius > sight.WIDEST_PX:
        return sight.NO_WORD
    u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
    low, high = (np.floor(np.array([v, u]) + side * radius + 0.5).astype(int) for side in (-1, 1))
    if (low < 0).any() or high[0] >= CAMERA.height or high[1] >= CAMERA.width:
        return sight.NO_WORD
    here = (n, slice(low[0], high[0] + 1), slice(low[1], high[1] + 1))
    sure, bits = look.looks.near[here] > 0, look.looks.kinds[here]
    nearest, furthest_in = INVERSE_DEPTHS[look.looks.near[here]], INVERSE_DEPTHS[look.looks.far[here]]
    slack = slack_m + spread
    before = sure & (furthest_in > (1.0 / (z - slack) + gate * sigma if slack < z else np.inf))
    beyond = sure & (nearest < 1.0 / (z + slack) - gate * sigma) & ~before
    own = bits & kinds != 0
    if (sure & ~before & ~beyond & own).any():
        return sight.AGREES
    if beyond.all():
        return sight.PAST if own.any() else sight.THROUGH
    if before.any():
        return sight.HIDDEN if before.sum() == sure.sum() else sight.NO_WORD
    return sight.NO_WORD if own.any() or (bits & MOVING).any() else sight.BARE


@pytest.mark.kernels
def test_words_of_looks_are_as_by_single_points():
    rng = np.random.default_rng(3)
    look = seen(Passing(0))
    holes = rng.random(look.looks.near.shape) < 0.05
    spotted = replace(look.looks, near=np.where(holes, 0, look.looks.near).astype(np.uint8))
    look = replace(look, looks=spotted)
    points = np.column_stack([rng.uniform(-1.0, 28.0, 150), rng.uniform(-3.0, 23.0, 150), rng.uniform(-2.0, 3.0, 150)])
    points[:40] = np.array([POLE_M, POLE_NORTH, 0.0]) + rng.normal(0.0, 0.1, (40, 3))
    variance, kinds = rng.uniform(0.0, 0.01, 150), rng.choice(np.array([4, 8, 16], np.uint8), 150)
    s = ChangeSettings()
    limits = np.array([s.see_m, s.gate_sigma, s.slack_m, look.looks.sigma])
    camera = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    out = np.zeros((len(look), 150), np.uint8)
    sight.look_at(
        points, variance, kinds, se3.inverse(look.T_map_cam), look.variance, camera, look.looks.near, look.looks.far,
        look.looks.kinds, INVERSE_DEPTHS, limits, out,
    )  # fmt: skip
    want = [
        [naive_word(p, w, int(k), look, n, limits) for p, w, k in zip(points, variance, kinds, strict=True)]
        for n in range(len(look))
    ]
    np.testing.assert_array_equal(out, want)
    assert set(np.unique(out)) == set(range(6))
    assert len(INVERSE_DEPTHS) == len(DEPTHS_M) + 2
