"""What stands on the ground in a view's own depth, whatever its label says, is shown in no orthophoto."""

from dataclasses import replace

import numpy as np
import pytest

from made_ground import MadeStreet, Walker
from wayloom.ground.exposure import DriveExposure
from wayloom.ground.making import chosen_keyframes, make_sheets, raster_around, views_of
from wayloom.ground.picture import picture_of
from wayloom.ground.settings import GroundSettings
from wayloom.ground.standing import pieces, without_standing
from wayloom.ground.surface import surface_of

SETTINGS = GroundSettings()
MISSED, LEGLESS = (2, 3, 5, 8), (1, 4, 6, 7)


@pytest.fixture(scope="module")
def street():
    return MadeStreet(walker=Walker(13.0, -1.5, 0.12, MISSED, LEGLESS))


@pytest.fixture(scope="module")
def views(street):
    odometry, n = street.odometry(), street.count
    exposure = DriveExposure(np.ones(n), np.zeros(n), 255.0, 0.0)
    return views_of(street, odometry, street, street.submaps()[0], chosen_keyframes(odometry, SETTINGS), exposure, SETTINGS)


def of_the_walker(street, views, judged):
    """Largest share of the walker in a pixel of the orthophoto, how many have any, and how many there are."""
    plain = [view for _, view in views]
    raster = raster_around(plain, SETTINGS.reach_m)
    height = surface_of(plain, raster, street.rig, 0.0, SETTINGS).height
    shown = [without_standing(view, raster, height, street.rig, 0.0, SETTINGS) for view in plain] if judged else plain
    there = []
    for (frame, _), view in zip(views, shown, strict=True):
        walker = np.isfinite(street.walker_at(frame, street.T_enu_cam[frame])[0])[view.first_row :, :, None]
        there.append(replace(view, image=(255 * walker).astype(np.uint8)))
    picture = picture_of(there, raster, height, street.rig, 0.0, SETTINGS)
    share = picture.colour[picture.sharpness > 0.0] / 255.0
    return float(share.max()), int((share > 0.004).sum()), len(share)


def test_a_person_whom_the_network_misses_in_some_frames_is_nowhere_in_the_orthophoto(street, views):
    most, some, pixels = of_the_walker(street, views, judged=True)
    assert (most, some) == (0.0, 0)
    assert pixels > 20000


def test_without_their_own_depth_the_views_would_show_that_person(street, views):
    most, some, _ = of_the_walker(street, views, judged=False)
    assert most > 0.5
    assert some > 100


def test_the_sheet_of_a_street_with_a_missed_person_is_as_dark_as_that_without(street):
    def brightest(log):
        return next(iter(make_sheets(log, log.odometry(), log, log.submaps()))).colour.max()

    exposure = brightest(MadeStreet())
    assert brightest(street) <= exposure + 2


def test_ground_where_nothing_stands_is_shown_as_before(street):
    clean = MadeStreet()
    odometry, n = clean.odometry(), clean.count
    exposure = DriveExposure(np.ones(n), np.zeros(n), 255.0, 0.0)
    seen = views_of(clean, odometry, clean, clean.submaps()[0], chosen_keyframes(odometry, SETTINGS), exposure, SETTINGS)
    views = [view for _, view in seen]
    raster = raster_around(views, SETTINGS.reach_m)
    height = surface_of(views, raster, clean.rig, 0.0, SETTINGS).height
    for view in views:
        near = slice(CLOSE_ROW - view.first_row, None)
        judged = without_standing(view, raster, height, clean.rig, 0.0, SETTINGS)
        matched = np.isfinite(view.above[near])
        before, after = (one.shown[near][matched] > 0.0 for one in (view, judged))
        assert after[before].mean() > 0.95  # the kerb stands


def kept_bytes(array):
    """Of the memory that an array keeps from being freed."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array.nbytes


def test_a_view_keeps_no_picture_beyond_the_rows_that_sheets_are_made_of(street):
    odometry, n = street.odometry(), street.count
    exposure = DriveExposure(np.ones(n), np.zeros(n), 255.0, 0.0)
    seen = views_of(street, odometry, street, street.submaps()[0], chosen_keyframes(odometry, SETTINGS), exposure, SETTINGS)
    assert len(seen) > 3
    for _, view in seen:
        assert view.first_row > 0
        for held in (view.above, view.image, view.right, view.shown):
            assert held.shape[:2] == view.above.shape
            assert kept_bytes(held) == held.nbytes


CLOSE_ROW = 85
"""The road is nearer than 10 m from here on."""


def test_only_pieces_that_are_large_enough_are_kept():
    pixels = np.zeros((8, 9), bool)
    pixels[1, 1:4], pixels[5:7, 5:7], pixels[3, 3] = True, True, True
    kept = pieces(pixels, 4)
    assert kept.sum() == 4
    assert kept[5:7, 5:7].all()
