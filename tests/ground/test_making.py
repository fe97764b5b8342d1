"""Ground sheets of a made street with exact ground."""

import numpy as np
import pytest

from made_ground import KERB_AT_M, KERB_M, PERSON_GREY, MadeStreet, grey_at
from wayloom.config.classes import CLASS_ID
from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.ground.making import make_sheets
from wayloom.ground.sheet import CELL_M, PIXEL_M


def sheets_of(street, pieces=1):
    return list(make_sheets(street, street.odometry(), street, street.submaps(pieces)))


@pytest.fixture(scope="module")
def street():
    return MadeStreet()


@pytest.fixture(scope="module")
def sheet(street):
    return sheets_of(street)[0]


def cells_enu(street, sheet):
    """(N, 3) ENU of all cells with a height, and their rows and columns."""
    T_enu_sheet = street.submaps()[0].T_enu_submap @ sheet.T_submap_sheet
    r, c = np.nonzero(np.isfinite(sheet.height))
    xy = sheet.corner_m + (np.column_stack([c, r]) + 0.5) * CELL_M
    return se3.transform(T_enu_sheet, np.column_stack([xy, sheet.height[r, c]])), r, c


def test_a_sheet_stands_level_with_its_x_axis_to_the_east(street, sheet):
    R = (street.submaps()[0].T_enu_submap @ sheet.T_submap_sheet)[:3, :3]
    np.testing.assert_allclose(R, np.eye(3), atol=1e-12)


def test_the_road_before_the_cameras_is_covered_and_within_three_centimetres(street, sheet):
    enu, _, _ = cells_enu(street, sheet)
    here = (np.abs(enu[:, 0]) < 2.5) & (enu[:, 1] > 8.0) & (enu[:, 1] < 18.0)
    assert here.sum() > 0.98 * (5.0 / CELL_M) * (10.0 / CELL_M)
    assert np.abs(enu[here, 2]).max() < 0.03
    assert np.median(np.abs(enu[here, 2])) < 0.01


def test_the_sidewalk_is_higher_by_the_kerb(street, sheet):
    enu, _, _ = cells_enu(street, sheet)
    along = (enu[:, 1] > 8.0) & (enu[:, 1] < 16.0)
    road = along & (enu[:, 0] > KERB_AT_M - 0.8) & (enu[:, 0] < KERB_AT_M - 0.3)
    beside = along & (enu[:, 0] > KERB_AT_M + 0.3) & (enu[:, 0] < KERB_AT_M + 0.8)
    assert np.median(enu[beside, 2]) - np.median(enu[road, 2]) == pytest.approx(KERB_M, abs=0.02)


def test_errors_are_as_large_as_their_sigmas_say_or_smaller(street, sheet):
    enu, r, c = cells_enu(street, sheet)
    away = (np.abs(enu[:, 0] - KERB_AT_M) > 0.5) & (enu[:, 1] < 20.0)
    error = enu[away, 2] - np.where(enu[away, 0] > KERB_AT_M, KERB_M, 0.0)
    assert np.mean(np.abs(error) < 3.0 * sheet.sigma_mm[r, c][away] / 1000.0) > 0.98


def test_classes_are_voted_by_the_labels(street, sheet):
    enu, r, c = cells_enu(street, sheet)
    label = sheet.label[r, c]
    near = (enu[:, 1] > 8.0) & (enu[:, 1] < 16.0)
    assert (label[near & (enu[:, 0] < KERB_AT_M - 0.3)] == CLASS_ID["road"]).mean() > 0.99
    assert (label[near & (enu[:, 0] > KERB_AT_M + 0.3) & (enu[:, 0] < 6.0)] == CLASS_ID["sidewalk"]).mean() > 0.99


def pixel_greys(street, sheet):
    """Orthophoto's and true grey of the pixels between 8 and 14 m."""
    T_enu_sheet = street.submaps()[0].T_enu_submap @ sheet.T_submap_sheet
    r, c = np.nonzero(sheet.sharpness > 6)
    xy = sheet.corner_m + (np.column_stack([c, r]) + 0.5) * PIXEL_M
    enu = se3.transform(T_enu_sheet, np.column_stack([xy, np.zeros(len(xy))]))
    here = (np.abs(enu[:, 0]) < 2.5) & (enu[:, 1] > 8.0) & (enu[:, 1] < 14.0)
    return sheet.colour[r[here], c[here], 0].astype(float), grey_at(enu[here, 0], enu[here, 1]).ravel().astype(float)


def test_the_orthophoto_shows_the_ground_where_it_is(street, sheet):
    shown, true = pixel_greys(street, sheet)
    assert len(shown) > 8000
    assert np.corrcoef(shown**2, true)[0, 1] > 0.8  # the tone curve is a root


def test_exposures_that_differ_leave_the_orthophoto_as_it_is(street, sheet):
    rng = np.random.default_rng(3)
    other = MadeStreet(gains=rng.uniform(0.6, 1.1, street.count))
    there = sheets_of(other)[0]
    shown, true = pixel_greys(other, there)
    np.testing.assert_allclose(
        np.corrcoef(shown**2, true)[0, 1], np.corrcoef(pixel_greys(street, sheet)[0] ** 2, true)[0, 1], atol=0.05
    )


def test_a_person_is_nowhere_in_the_orthophoto():
    street = MadeStreet(person=(4, 100, 80, 140, 140))
    assert (street.frame(4).left == PERSON_GREY).sum() == 40 * 60
    sheet = sheets_of(street)[0]
    clean = sheets_of(MadeStreet())[0]
    assert sheet.colour.max() <= clean.colour.max() + 2  # the person is white, the ground is not
    both = min(sheet.colour.shape[0], clean.colour.shape[0]), min(sheet.colour.shape[1], clean.colour.shape[1])
    assert sheet.colour[: both[0], : both[1]].max() < 250


def test_a_second_run_gives_the_same_bits(street, sheet):
    assert sheets_of(MadeStreet())[0].encoded == sheet.encoded


def test_two_submaps_give_two_sheets_in_the_order_of_the_road(street):
    submaps = street.submaps(2)
    found = list(make_sheets(street, street.odometry(), street, submaps))
    assert [one.submap for one in found] == [item.submap.digest for item in submaps]


@pytest.mark.parametrize("count", [1, 2])
def test_several_threads_make_the_same_sheets_to_the_bit(street, count):
    submaps = street.submaps(count)
    alone, side_by_side = (list(make_sheets(street, street.odometry(), street, submaps, threads=threads)) for threads in (1, 4))
    assert [one.encoded for one in side_by_side] == [one.encoded for one in alone]


@pytest.mark.parametrize("threads", [1, 4])
def test_progress_rises_to_its_end(street, threads):
    told, submaps = [], street.submaps(2)
    list(make_sheets(street, street.odometry(), street, submaps, progress=lambda share, _: told.append(share), threads=threads))
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_an_image_that_cannot_be_read_is_told_whatever_the_threads(street):
    class Broken:
        def left(self, keyframe):
            if keyframe == 1:
                raise StageError("no labels")
            return street.left(keyframe)

    for threads in (1, 4):
        with pytest.raises(StageError, match="no labels"):
            list(make_sheets(street, street.odometry(), Broken(), street.submaps(), threads=threads))


def test_a_drive_that_sees_no_ground_has_no_sheet(street):
    class Walls:
        def left(self, keyframe):
            return np.full((street.rig.camera.height, street.rig.camera.width), CLASS_ID["building"], np.uint8)

    assert list(make_sheets(street, street.odometry(), Walls(), street.submaps())) == []
