"""Vignetting told by the ground that several views show, and undone in the orthophoto."""

import numpy as np
import pytest

from made_ground import MadeStreet
from wayloom.ground import exposure as exposure_module
from wayloom.ground.exposure import DriveExposure, drive_exposure
from wayloom.ground.making import chosen_keyframes, raster_around, views_of
from wayloom.ground.picture import picture_of
from wayloom.ground.settings import GroundSettings
from wayloom.ground.surface import surface_of
from wayloom.ground.vignetting import LARGEST, LEAST_STRETCHES, agreed, fall_off_of, stretch_fall_offs, stretches

SETTINGS = GroundSettings(reach_m=15.0)


def drive_of(**how):
    street = MadeStreet(count=24, step_m=0.85, **how)
    return street, street.odometry(), street


def test_the_views_of_a_street_tell_how_its_camera_darkens_the_border():
    """The made street's grain is coarse: over patches of three pixels it moves the fall-off of a stretch by a tenth."""
    gains = np.random.default_rng(4).uniform(0.7, 1.0, 24)
    balance = np.ones(24), np.zeros(24)  # the odometry followed nothing: exposures are told beside it
    told = []
    for fall_off in (0.0, 0.6):
        told_here, information = stretch_fall_offs(*drive_of(fall_off=fall_off, gains=gains), balance)
        assert len(told_here) == 2
        assert (information > 0.0).all()
        told.append(told_here)
    np.testing.assert_allclose(told[0], 0.0, atol=0.15)
    np.testing.assert_allclose(told[1] - told[0], 0.6, atol=0.03)


def test_a_camera_without_vignetting_under_a_skewed_light_is_told_from_one_with():
    """Ground that is brighter from near is no fall towards the border."""
    rng = np.random.default_rng(1)
    depth = np.log(rng.uniform(4.0, 16.0, (6, 300)))
    fall = np.log1p(rng.uniform(0.0, 0.8, (6, 300)))
    level = 4.5 + rng.normal(0.0, 0.2, 300) - 0.3 * depth + 0.1 * np.arange(6)[:, None] + rng.normal(0.0, 0.02, (6, 300))
    for fall_off in (0.0, 0.5):
        told = fall_off_of(level - fall_off * fall, fall, depth)
        assert told is not None
        assert told[0] == pytest.approx(fall_off, abs=0.02)
    level[:, 30:] = np.nan
    assert fall_off_of(level, fall, depth) is None


def test_stretches_that_disagree_or_are_few_leave_the_picture_as_it_is():
    same = np.ones(9)
    assert agreed(np.full(9, 0.4), same) == 0.4
    assert agreed(np.linspace(-1.0, 1.4, 9), same) == 0.0
    assert agreed(np.full(9, -0.4), same) == 0.0
    assert agreed(np.full(LEAST_STRETCHES - 1, 0.4), same[: LEAST_STRETCHES - 1]) == 0.0
    assert agreed(np.zeros(0), np.zeros(0)) == 0.0
    assert agreed(np.full(9, 7.0), same) == LARGEST
    assert agreed(np.array([0.5] * 5 + [-3.0] * 4), np.array([1.0] * 5 + [0.01] * 4)) == 0.5


def test_stretches_do_not_overlap_and_stay_within_a_segment():
    odometry = MadeStreet(count=24, step_m=0.85).odometry()
    found = stretches(odometry)
    assert found == [list(range(0, 12, 2)), list(range(11, 23, 2))]
    odometry.keyframes.segment[5:] = 1
    assert all(min(rows) >= 5 or max(rows) < 5 for rows in stretches(odometry))


def test_an_orthophoto_of_a_camera_with_vignetting_is_that_of_one_without():
    pictures = []
    for fall_off, undone in ((0.0, 0.0), (0.6, 0.6), (0.6, 0.0)):
        street = MadeStreet(count=6, fall_off=fall_off)
        odometry = street.odometry()
        exposure = DriveExposure(np.ones(6), np.zeros(6), 255.0, undone)
        chosen = chosen_keyframes(odometry, SETTINGS)
        views = [view for _, view in views_of(street, odometry, street, street.submaps()[0], chosen, exposure, SETTINGS)]
        about = (odometry.rig, 0.0, SETTINGS)
        raster = raster_around(views, SETTINGS.reach_m)
        pictures.append(picture_of(views, raster, surface_of(views, raster, *about).height, *about))
    plain, told, left = pictures
    both = (plain.sharpness > 0.0) & (told.sharpness > 0.0) & (left.sharpness > 0.0)
    assert both.sum() > 10_000
    share = [one.colour[both] / plain.colour[both] for one in (told, left)]
    assert np.percentile(np.abs(share[0] - 1.0), 90) < 0.02
    assert np.median(share[1]) < 0.95


def test_what_vignetting_is_told_goes_to_every_view_and_lifts_the_white_of_the_drive(monkeypatch: pytest.MonkeyPatch):
    exposures = []
    for fall_off, told in ((0.0, 0.0), (0.6, 0.6), (0.6, 0.0)):
        street, odometry, labels = drive_of(fall_off=fall_off)
        monkeypatch.setattr(exposure_module, "drive_fall_off", lambda *of, told=told: told)
        exposures.append(drive_exposure(street, odometry, labels))
    plain, lifted, dark = exposures
    assert (plain.fall_off, lifted.fall_off) == (0.0, 0.6)
    assert lifted.white == pytest.approx(plain.white, rel=0.02)
    assert dark.white < 0.96 * plain.white
    views = views_of(street, odometry, labels, street.submaps()[0], chosen_keyframes(odometry, SETTINGS), lifted, SETTINGS)
    assert [view.fall_off for _, view in views] == [0.6] * len(views) != []
