"""The place index finds a place again by its features or by what stands around it, whatever else it holds and in any order."""

from dataclasses import replace

import numpy as np
import pytest

from places.made_places import random_places
from wayloom.errors import InputError
from wayloom.places.birds_eye import SHAPE
from wayloom.places.bit_tables import COMMON, FLIPS, FULL_WEIGHT, KEY_BITS, POSITIONS, BitTables
from wayloom.places.index import FEATURES, Gate, PlaceIndex, PlaceQuery, Positions, Stretch, held_features, query_at
from wayloom.places.road import road_m
from wayloom.places.types import Places, PlaceStations

SPACING = 10


def made(seed: int, keyframes: int = 60) -> Places:
    """Random features along a metre a keyframe, and a random town around each station."""
    rng = np.random.default_rng(1000 + seed)
    rows = np.arange(0, keyframes, SPACING, dtype=np.int32)
    grid = np.where(rng.random((len(rows), *SHAPE)) < 0.1, rng.integers(10, 45, (len(rows), *SHAPE)), 0).astype(np.uint8)
    return replace(random_places(seed, keyframes), stations=PlaceStations(rows, grid))


def passed_again(places: Places, seed: int, flipped: float = 0.08) -> Places:
    """The same places with some bits of each descriptor changed, half of the features new, and other surroundings."""
    rng = np.random.default_rng(seed)
    f = places.features
    noise = np.packbits(rng.random((len(f), 256)) < flipped, axis=1)
    bits = np.where(rng.random(len(f))[:, None] < 0.5, rng.integers(0, 256, f.bits.shape).astype(np.uint8), f.bits ^ noise)
    return replace(places, features=replace(f, bits=bits), stations=made(seed).stations)


def filled(seeds: range) -> PlaceIndex:
    index = PlaceIndex()
    for seed in seeds:
        index.add(f"drive-{seed}", made(seed))
    return index


def test_a_place_passed_again_is_the_first_candidate_by_appearance():
    index = filled(range(12))
    found = index.candidates(query_at(passed_again(made(7), seed=50), 3))[0]
    assert (found.drive_id, found.anchor, found.kind, found.yaw_rad) == ("drive-7", 30, "appearance", 0.0)


@pytest.mark.parametrize(("shift", "is_turned"), [((0, 0), False), ((2, -1), False), ((-3, 2), True), ((1, 0), True)])
def test_surroundings_that_are_moved_or_turned_are_found_with_a_guess_of_the_heading(shift, is_turned):
    index, places = filled(range(12)), made(5)
    grid = np.roll(places.stations.grid[2], shift, axis=(1, 2))
    query = PlaceQuery(np.zeros((0, 32), np.uint8), grid[:, ::-1, ::-1].copy() if is_turned else grid)
    found = index.candidates(query)[0]
    assert (found.drive_id, found.anchor, found.kind) == ("drive-5", 20, "surroundings")
    assert found.yaw_rad == (np.pi if is_turned else 0.0)


def test_the_order_in_which_drives_come_and_go_does_not_count():
    one, other = filled(range(8)), PlaceIndex()
    for seed in (3, 99, 6, 0, 7, 1):
        other.add(f"drive-{seed}", made(seed))
    other.candidates(query_at(made(99), 0))
    other.remove("drive-99")
    for seed in (5, 4, 2):
        other.add(f"drive-{seed}", made(seed))
    for station in range(6):
        query = query_at(passed_again(made(4), seed=60), station)
        assert one.candidates(query) == other.candidates(query)


def test_a_removed_drive_is_found_no_more():
    index = filled(range(5))
    index.remove("drive-2")
    for station in range(6):
        assert all(found.drive_id != "drive-2" for found in index.candidates(query_at(made(2), station)))
    assert len(index) == 4 * 6
    with pytest.raises(InputError, match="no drive drive-2"):
        index.remove("drive-2")


def test_a_drive_is_not_added_twice():
    index = filled(range(2))
    with pytest.raises(InputError, match="already"):
        index.add("drive-1", made(1))


def test_a_gate_keeps_out_what_lies_elsewhere_but_not_what_has_no_position():
    index = PlaceIndex()
    near, far, lost = made(1), made(1), made(1)
    at = np.column_stack([np.zeros(6), 10.0 * np.arange(6)])
    index.add("near", near, Positions(at, np.full(6, 2.0)))
    index.add("far", far, Positions(at + np.array([200.0, 0.0]), np.full(6, 2.0)))
    index.add("unsure", far, Positions(at + np.array([200.0, 0.0]), np.full(6, 100.0)))
    index.add("lost", lost)
    query = query_at(near, 3)
    assert {found.drive_id for found in index.candidates(query, gate=Gate((0.0, 30.0), 2.0))} == {"near", "unsure", "lost"}
    assert {found.drive_id for found in index.candidates(query)} == {"near", "far", "unsure", "lost"}


def test_the_stretch_that_the_query_stands_on_is_no_candidate():
    index, places = filled(range(3)), made(1)
    road = road_m(places.T_world_keyframe)[places.stations.keyframe[3]]
    for found in index.candidates(query_at(places, 3), without=Stretch("drive-1", road - 15.0, road + 15.0)):
        assert found.drive_id != "drive-1" or abs(found.anchor - 30) > 15


def test_candidates_of_a_drive_lie_apart():
    anchors = [found.anchor for found in filled(range(1)).candidates(query_at(made(0), 2))]
    assert len(anchors) > 1
    assert min(abs(a - b) for i, a in enumerate(anchors) for b in anchors[:i]) >= 15


def test_an_empty_index_has_no_candidates():
    assert PlaceIndex().candidates(query_at(made(0), 0)) == []


def test_the_memory_of_a_keyframe_is_bounded():
    """Of FEATURES descriptors in two tables, twelve bytes an entry; grids and rows are doubled as they grow."""
    index = filled(range(20))
    index.candidates(query_at(made(0), 0))
    described = 20 * 60
    grids = 2 * len(index) * 2500
    assert index.nbytes <= described * min(FEATURES, 20) * 2 * 12 + grids + (4 << 9)


def test_features_are_held_for_the_nearest_station():
    places = made(3)
    rows, station = held_features(places)
    road = road_m(places.T_world_keyframe)
    for row, number in zip(rows.tolist(), station.tolist(), strict=True):
        apart = np.abs(road[places.features.keyframe[row]] - road[places.stations.keyframe])
        assert apart[number] == apart.min()


def test_of_a_keyframe_with_many_features_some_are_held_spread_over_all():
    places = made(3, keyframes=2)
    f = places.features
    many = 300
    places = replace(
        places,
        features=replace(
            f, keyframe=np.zeros(many, np.int32), bits=np.zeros((many, 32), np.uint8), uv=np.zeros((many, 2), np.float32),
            p_cam=np.ones((many, 3), np.float32), sigma_m=np.ones(many, np.float32),
        ),
    )  # fmt: skip
    rows, _ = held_features(places)
    assert len(rows) == FEATURES
    assert np.diff(rows).max() <= -(-many // FEATURES)


def naive_votes(held: list[tuple[bytes, int]], bits: np.ndarray, owners: int) -> np.ndarray:
    """Every descriptor against every other one, key by key."""

    def key(descriptor: np.ndarray, table: int) -> list[int]:
        return [int(descriptor[p // 8] >> (p % 8)) & 1 for p in POSITIONS[table].tolist()]

    votes = np.zeros(owners, np.int64)
    for table in range(len(POSITIONS)):
        entries = {(tuple(key(np.frombuffer(d, np.uint8), table)), owner) for d, owner in held}
        for descriptor in bits:
            own = key(descriptor, table)
            found = [owner for other, owner in entries if sum(a != b for a, b in zip(own, other, strict=True)) <= 1]
            if 0 < len(found) <= COMMON:
                for owner in found:
                    votes[owner] += FULL_WEIGHT // len(found)
    return votes


@pytest.mark.kernels
def test_votes_are_those_of_every_pair_of_keys_that_differ_in_a_bit_at_most():
    rng = np.random.default_rng(8)
    words = rng.integers(0, 256, (12, 32)).astype(np.uint8)
    near = words[rng.integers(0, 12, 200)] ^ np.packbits(rng.random((200, 256)) < 0.02, axis=1)
    owners = np.concatenate([rng.integers(0, 5, 120), rng.integers(4, 9, 80)]).astype(np.int32)
    tables = BitTables()
    tables.replace(np.zeros(9, bool), near[:120], owners[:120])
    tables.replace(np.arange(9) == 4, near[120:], owners[120:])
    held = [(d.tobytes(), o) for i, (d, o) in enumerate(zip(near, owners.tolist(), strict=True)) if i >= 120 or o != 4]
    queries = words ^ np.packbits(rng.random((12, 256)) < 0.02, axis=1)
    expected = naive_votes(held, queries, 9)
    assert expected.sum() > 0
    np.testing.assert_array_equal(tables.votes(queries, 9), expected)
    assert len(FLIPS) == KEY_BITS + 1
