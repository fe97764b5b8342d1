"""A look says how far a drive saw: never further than the street lies, to infinity in the sky, and in little room."""

from dataclasses import replace

import numpy as np
import pytest

from odometry.made_street import CAMERA, RIG, render
from places.made_places import CAR_COLUMNS, SKY_ROWS, MadeLabels, made_drive
from wayloom.config.classes import CLASS_ID
from wayloom.dense.extraction import dense_depth, look_of, make_looks, small_camera
from wayloom.dense.files import LookFile, encode_looks, save_looks
from wayloom.dense.kernels.patches import encode_depths, keep_returning, reduce_patches
from wayloom.dense.settings import LookSettings
from wayloom.dense.types import BUILT, DEPTHS_M, INFINITY, MOVING, OPEN_SKY, THIN, UNSURE, Looks
from wayloom.errors import InputError
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.places.stereo_pair import read_pair

LARGEST_BYTES_A_LOOK = 15_000
SMALL = LookSettings(width_px=128)


@pytest.fixture(scope="module")
def looks() -> Looks:
    log, odometry, _, images = made_drive()
    return make_looks(log, odometry, images, SMALL).looks()


def depth_of_code(code):
    return DEPTHS_M[np.clip(code.astype(int), 1, 254) - 1]


def true_depth(log, frame, image_camera):
    return 1.0 / render(log.truth[frame], image_camera)[1]


def test_the_true_depth_lies_between_nearest_and_furthest(looks):
    log = made_drive()[0]
    edge = small_camera(CAMERA, SMALL.width_px)[1]
    for row, frame in enumerate(looks.frame.tolist()):
        depth = true_depth(log, frame, CAMERA)[edge // 2 :: edge, edge // 2 :: edge]
        near, far = looks.near[row, : len(depth)], looks.far[row, : len(depth)]
        known = (near != UNSURE) & (looks.kinds[row, : len(depth)] == BUILT)
        assert known.mean() > 0.5
        sigma = depth * depth / RIG.bf * 0.5  # half a pixel of disparity
        within = (depth_of_code(near) - 2.0 * sigma < depth) & (depth < depth_of_code(far) + 2.0 * sigma)
        assert within[known].mean() > 0.97


def test_the_sky_is_a_look_to_infinity_unless_stereo_says_otherwise():
    images = made_drive(frames=1)[3]
    camera, edge = small_camera(CAMERA, SMALL.width_px)
    depth = np.full(images.image.shape, np.nan)
    depth[: SKY_ROWS // 2] = 5.0
    near, far, kinds = look_of(depth, images.image, camera, edge, 0.5)
    rows = slice(SKY_ROWS // 2 // edge + 1, SKY_ROWS // edge)
    columns = slice(CAR_COLUMNS // edge + 1, None)
    assert (near[rows, columns] == INFINITY).all()
    assert (far[rows, columns] == INFINITY).all()
    assert (kinds[rows, columns] == OPEN_SKY).all()
    assert (near[: SKY_ROWS // 2 // edge] == UNSURE).all()


def test_what_moves_is_told_apart(looks):
    edge = small_camera(CAMERA, SMALL.width_px)[1]
    cars = looks.kinds[:, SKY_ROWS // edge + 1 :, : CAR_COLUMNS // edge]
    assert (cars == MOVING).all()


def test_a_pole_of_one_pixel_is_the_nearest_of_its_patch_and_no_other():
    camera, edge = small_camera(CAMERA, 88)
    shape = (CAMERA.height, CAMERA.width)
    depth, label = np.full(shape, 20.0), np.full(shape, CLASS_ID["building"], np.uint8)
    column = 5 * edge + 1
    depth[:, column], label[:, column] = 8.0, CLASS_ID["pole"]
    near, far, kinds = look_of(depth, label, camera, edge, 0.5)
    assert (depth_of_code(near[:, 5]) <= 8.0).all()
    assert (depth_of_code(far[:, 5]) >= 20.0).all()
    assert (kinds[:, 5] == THIN | BUILT).all()
    others = np.arange(near.shape[1]) != 5
    np.testing.assert_allclose(depth_of_code(near[:, others]), 20.0, rtol=0.02)


def test_codes_are_rounded_away_from_what_they_enclose():
    camera, edge = small_camera(CAMERA, CAMERA.width)
    depth = np.linspace(1.0, 80.0, CAMERA.width * CAMERA.height).reshape(CAMERA.height, CAMERA.width)
    near, far, _ = look_of(depth, np.zeros(depth.shape, np.uint8), camera, edge, 0.5)
    assert (depth_of_code(near) <= depth).all()
    assert (depth_of_code(far) >= depth).all()
    np.testing.assert_allclose(depth_of_code(near), depth, rtol=0.018)


def test_wide_images_are_matched_smaller_and_see_the_same_street():
    log, odometry, _, images = made_drive(frames=1)
    pair = read_pair(log, 0, images.image, RightRectifier(RIG, odometry.lens, np.zeros(3)))
    true = true_depth(log, 0, CAMERA)
    for width in (CAMERA.width, CAMERA.width // 2):
        depth = dense_depth(pair, RIG, 0.0, LookSettings(match_width_px=width))
        near = np.isfinite(depth) & (true < 10.0)
        assert near.mean() > 0.2
        assert np.median(np.abs(depth - true)[near] / true[near]) < 0.02


def test_the_bias_of_the_drive_is_taken_out():
    log, odometry, _, images = made_drive(frames=1)
    pair = read_pair(log, 0, images.image, RightRectifier(RIG, odometry.lens, np.zeros(3)))
    plain, biased = (dense_depth(pair, RIG, bias, LookSettings()) for bias in (0.0, 0.5))
    both = np.isfinite(plain) & np.isfinite(biased)
    np.testing.assert_allclose(RIG.bf / plain[both] - RIG.bf / biased[both], 0.5, atol=1e-9)


def test_the_same_drive_gives_the_same_bytes_in_little_room(looks):
    log, odometry, _, images = made_drive()
    data = encode_looks(make_looks(log, odometry, images, SMALL))
    assert data == encode_looks(looks)
    assert len(data) < LARGEST_BYTES_A_LOOK * len(looks)


def test_looks_that_wait_in_a_file_are_the_same(looks, monkeypatch):
    monkeypatch.setattr("wayloom.files.growing_arrays.IN_MEMORY_BYTES", 0)
    monkeypatch.setattr("wayloom.files.blob.PIECE_BYTES", 1000)
    log, odometry, _, images = made_drive()
    made = make_looks(log, odometry, images, SMALL)
    assert not made.packed.flags.writeable  # it is a view of a file
    assert encode_looks(made) == encode_looks(looks)
    np.testing.assert_array_equal(made.looks().near, looks.near)


def test_a_file_gives_the_looks_that_are_asked_for(looks, tmp_path):
    save_looks(looks, tmp_path / "drive.looks")
    file = LookFile(tmp_path / "drive.looks")
    assert (file.camera, file.sigma) == (looks.camera, looks.sigma)
    some = file.of_frames(looks.frame[[1, 3]])
    want = looks.take(np.array([1, 3]))
    for name in ("frame", "near", "far", "kinds"):
        np.testing.assert_array_equal(getattr(some, name), getattr(want, name))
        np.testing.assert_array_equal(getattr(file.read(), name), getattr(looks, name))
    assert len(file.of_frames(np.array([999_999]))) == 0


def test_a_drive_without_keyframes_has_a_file_without_looks(tmp_path, looks):
    save_looks(looks.take(np.zeros(0, np.int64)), tmp_path / "drive.looks")
    assert len(LookFile(tmp_path / "drive.looks").read()) == 0


@pytest.mark.parametrize("damage", [lambda data: data[:-7], lambda data: b"WLPLACES" + data[8:], lambda data: b""])
def test_a_damaged_file_is_refused_by_name(looks, tmp_path, damage):
    path = tmp_path / "drive.looks"
    path.write_bytes(damage(encode_looks(looks)))
    with pytest.raises(InputError, match=r"drive\.looks.*run the stage looks again"):
        LookFile(path).read()


def test_a_look_whose_packing_is_damaged_is_refused_by_name(looks, tmp_path):
    path = tmp_path / "drive.looks"
    data = bytearray(encode_looks(looks))
    data[-200:] = bytes(200)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"drive\.looks.*damaged"):
        LookFile(path).read()


def test_labels_with_a_hole_are_void_and_of_no_kind():
    log, odometry, _, images = made_drive(frames=1)
    void = MadeLabels(np.full_like(images.image, 255))
    assert not make_looks(log, replace(odometry), void, SMALL).looks().kinds.any()


def naive_patches(near_code, far_code, kinds, edge, share):
    """With codes as large as kinds."""
    denied = (kinds == OPEN_SKY) & (near_code > 0) & (near_code < 255)
    near_code, far_code = (np.where(denied, 0, np.where(kinds == OPEN_SKY, 255, code)) for code in (near_code, far_code))
    height, width = (-(-side // edge) for side in near_code.shape)
    out = np.zeros((3, height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            here = (slice(y * edge, (y + 1) * edge), slice(x * edge, (x + 1) * edge))
            sure = near_code[here] > 0
            out[2, y, x] = np.bitwise_or.reduce(kinds[here], axis=None)
            if sure.sum() >= share * sure.size:
                out[:2, y, x] = near_code[here][sure].min(), far_code[here][sure].max()
    return out


@pytest.mark.kernels
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("edge", [1, 2, 5])
def test_patches_are_as_by_slices(edge, times):
    rng = np.random.default_rng(edge)
    small = (23 // times, 31 // times)
    near_code = (rng.choice([20, 90, 200, 255], small) * (rng.random(small) < 0.6)).astype(np.uint8)
    far_code = np.where(near_code > 0, np.minimum(near_code.astype(int) + 3, 255), 0).astype(np.uint8)
    kinds = rng.choice([MOVING, OPEN_SKY, THIN | BUILT], (23, 31)).astype(np.uint8)
    out = np.empty((3, -(-23 // edge), -(-31 // edge)), np.uint8)
    reduce_patches(near_code, far_code, times, kinds, OPEN_SKY, edge, 0.5, *out)
    large = np.zeros((2, 23, 31), np.uint8)
    for code, whole in zip((near_code, far_code), large, strict=True):
        whole[: times * small[0], : times * small[1]] = np.kron(code, np.ones((times, times), np.uint8))
    np.testing.assert_array_equal(out, naive_patches(*large, kinds, edge, 0.5))


@pytest.mark.kernels
def test_codes_of_depths_are_as_by_search():
    rng = np.random.default_rng(1)
    depth = np.exp(rng.uniform(-0.5, 5.0, (30, 40)))
    depth[3, :20], depth[4, :20], depth[5] = np.nan, np.inf, DEPTHS_M[:40]
    depth[6, :2] = DEPTHS_M[[0, -1]]
    near, far = np.empty(depth.shape, np.uint8), np.empty(depth.shape, np.uint8)
    encode_depths(depth, DEPTHS_M, near, far)
    for d, n, f in zip(depth.ravel(), near.ravel(), far.ravel(), strict=True):
        towards, away = np.flatnonzero(d >= DEPTHS_M), np.flatnonzero(d <= DEPTHS_M)
        code = towards[-1] + 1 if len(towards) else 1
        assert n == (UNSURE if np.isnan(d) else code if len(away) else INFINITY)
        assert f == (UNSURE if np.isnan(d) else away[0] + 1 if len(away) else INFINITY)


@pytest.mark.kernels
def test_a_disparity_is_kept_where_the_right_image_leads_back():
    rng = np.random.default_rng(2)
    there, right = np.where(rng.random((2, 12, 40)) < 0.9, rng.integers(16, 120, (2, 12, 40)) / 16.0, -1.0)
    sure = np.empty_like(there)
    keep_returning(there, np.ascontiguousarray(right[:, ::-1]), 1.5, sure)
    kept = np.zeros(there.shape, bool)
    for y, x in np.argwhere(there > 0):
        u_right = round(x - there[y, x])
        kept[y, x] = u_right >= 0 and right[y, u_right] > 0 and abs(there[y, x] - right[y, u_right]) <= 1.5
    assert kept.any()
    np.testing.assert_array_equal(sure, np.where(kept, there, np.nan))
