"""What is kept of a drive's places lies where the street is, on what stands still, and takes little room."""

from dataclasses import replace

import numpy as np
import pytest

from odometry.made_rig import LENS, LensLog
from odometry.made_rig import RIG as LENS_RIG
from odometry.made_street import CAMERA, PLANES, curve, render
from places.made_places import CAR_COLUMNS, SKY_ROWS, made_drive
from wayloom.errors import StageError
from wayloom.geometry.lens import displaced
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.places.cloud import VoxelFilter, hosted_points
from wayloom.places.extraction import make_places
from wayloom.places.features import spread
from wayloom.places.files import encode_places
from wayloom.places.road import spaced
from wayloom.places.settings import PlaceSettings
from wayloom.places.stereo_pair import read_pair, right_rectifier
from wayloom.places.types import Places

LARGEST_BYTES_A_KEYFRAME = 20_000


def places_of(log, odometry, labels, images, settings=PlaceSettings()) -> Places:
    return make_places(log, odometry, hosted_points(odometry, labels, settings), images, settings)


@pytest.fixture(scope="module")
def places() -> Places:
    return places_of(*made_drive())


def distance_to_the_street(points_world):
    return np.min([np.abs(points_world @ np.array(n) - d) for n, d in PLANES], axis=0)


def test_features_lie_on_the_street_within_their_sigmas(places):
    f = places.features
    T = places.T_world_keyframe[f.keyframe]
    points = np.einsum("nij,nj->ni", T[:, :3, :3], f.p_cam) + T[:, :3, 3]
    # A normal error is under three sigmas in 99.7 of 100; the rest of the twentieth is left to corners where two planes meet.
    assert np.mean(distance_to_the_street(points) < 3.0 * f.sigma_m + 0.01) > 0.95
    assert len(f) > 100 * len(np.unique(f.keyframe))


def test_points_lie_on_the_street_within_their_sigmas(places):
    c = places.cloud
    T = places.T_world_keyframe[c.keyframe]
    points = np.einsum("nij,nj->ni", T[:, :3, :3], 0.01 * c.p_cam) + T[:, :3, 3]
    assert np.mean(distance_to_the_street(points) < 0.03 * c.sigma_cm + 0.01) > 0.95
    assert len(c) > 4000


def test_nothing_is_kept_of_movers_and_sky(places):
    u, v = places.features.uv.T
    assert (u > CAR_COLUMNS - 1).all()
    assert (v > SKY_ROWS - 1).all()
    u, v = CAMERA.project(0.01 * places.cloud.p_cam.astype(float)).T
    assert (u > CAR_COLUMNS - 1).all()
    assert (v > SKY_ROWS - 1).all()


def test_a_keyframe_takes_no_more_than_20_kB_in_all(places):
    described = len(np.unique(places.features.keyframe))
    assert described == 6
    assert len(encode_places(places)) < LARGEST_BYTES_A_KEYFRAME * described


def test_the_same_drive_gives_the_same_bytes(places):
    assert encode_places(places_of(*made_drive())) == encode_places(places)


def test_places_whose_tables_wait_in_files_are_the_same(places, monkeypatch):
    monkeypatch.setattr("wayloom.files.growing_arrays.IN_MEMORY_BYTES", 0)
    monkeypatch.setattr("wayloom.files.blob.PIECE_BYTES", 1000)
    monkeypatch.setattr("wayloom.places.cloud.POINTS_AT_ONCE", 100)
    monkeypatch.setattr("wayloom.places.extraction.STATIONS_AT_ONCE", 1)
    made = places_of(*made_drive())
    assert not made.cloud.p_cam.flags.writeable  # it is a view of a file
    assert encode_places(made) == encode_places(places)


def test_labels_of_another_run_are_refused():
    log, odometry, labels, images = made_drive(frames=3)
    with pytest.raises(StageError, match="of different runs"):
        places_of(log, odometry, replace(labels, stereo=labels.stereo[:-1], baseline=labels.baseline[:-1]), images)


def test_the_right_image_is_rectified_as_the_odometry_found_its_lens_and_rows():
    """The result's row coefficients hold the lens's part; what the rectifier is given besides is the rows' own."""
    own = np.array([0.3, -0.2, 0.1])
    rectifier = RightRectifier(LENS_RIG, LENS, own)
    _, odometry, _, images = made_drive(frames=1)
    odometry = replace(odometry, rig=rectifier.rig, lens=LENS, row_coefficients=rectifier.all_rows())
    # What is left is their product: 0.3 px moved by a lens that changes angles by up to 0.01.
    np.testing.assert_allclose(right_rectifier(odometry).coefficients, own, atol=0.3 * 0.01)
    lens_alone = replace(odometry, row_coefficients=RightRectifier(LENS_RIG, LENS, np.zeros(3)).all_rows())
    log = LensLog(curve(1), LENS_RIG, lens=LENS)
    pair = read_pair(log, 0, images.image, right_rectifier(lens_alone))
    v, u = np.mgrid[20:160:12, 100:440:12]
    pixels = np.column_stack([u.ravel(), v.ravel()])
    depth, sigma = pair.depth(pixels, replace(lens_alone, rig=displaced(LENS_RIG, LENS)))
    true = 1.0 / render(log.truth[0], LENS_RIG.camera)[1][pixels[:, 1], pixels[:, 0]]
    found = np.isfinite(depth)
    assert found.sum() > 100
    assert np.mean(np.abs(depth - true)[found] < 3.0 * sigma[found]) > 0.95


def test_keyframes_are_taken_by_road_and_at_each_beginning_of_a_segment():
    road = np.array([0.0, 0.5, 2.0, 2.5, 3.0, 5.1])
    taken = spaced(road, np.array([0, 0, 0, 1, 1, 1], np.int32), 2.0)
    assert taken.tolist() == [True, False, True, True, False, True]


def test_the_strongest_corner_of_every_cell_comes_before_any_second_one():
    rng = np.random.default_rng(1)
    uv, response = rng.uniform([0, 0], [320, 200], (500, 2)), rng.random(500)
    side = (320 * 200 / 96) ** 0.5
    cells = {}
    for i, (u, v) in enumerate(uv):
        cells.setdefault((int(u // side), int(v // side)), []).append(i)
    ranked = [
        (rank, -response[i], i) for members in cells.values() for rank, i in enumerate(sorted(members, key=lambda i: -response[i]))
    ]
    assert spread(uv, response, (200, 320), 150).tolist() == sorted(i for _, _, i in sorted(ranked)[:150])


def test_the_voxel_filter_does_as_a_dictionary_of_voxels():
    rng = np.random.default_rng(2)
    voxels, kept = VoxelFilter(0.5, reach_m=2.0), []
    for road in range(6):
        points, sigma = rng.uniform(-2, 2, (80, 3)), rng.integers(1, 20, 80).astype(np.uint8)
        kept = [(at, cells) for at, cells in kept if at >= road - 2.0]
        taken, best = set().union(*(cells for _, cells in kept)), {}
        for i, cell in enumerate(map(tuple, np.floor(points / 0.5).astype(int).tolist())):
            if cell not in taken and (cell not in best or sigma[i] < sigma[best[cell]]):
                best[cell] = i
        kept.append((road, set(best)))
        assert voxels.rows(points, sigma, float(road)).tolist() == sorted(best.values())


def test_no_more_features_than_asked_for():
    places = places_of(*made_drive(frames=3), PlaceSettings(features=25))
    assert np.bincount(places.features.keyframe).max() <= 25
