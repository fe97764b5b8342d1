"""Kerbs placed by photo-consistency on a made street with an exact kerb."""

import numpy as np
import pytest

import made_ground
from made_ground import KERB_AT_M, KERB_M, MadeStreet
from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3
from wayloom.ground.edges import RISES_M, best_steps, find_steps, windowed
from wayloom.ground.exposure import DriveExposure
from wayloom.ground.making import chosen_keyframes, level_frame, make_sheets, raster_around, views_of
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M
from wayloom.ground.sides import give_to_sides, laid
from wayloom.ground.surface import fuse, gather
from wayloom.ground.view import BESIDE, ROAD

SETTINGS = GroundSettings()


class WrongLabels(MadeStreet):
    """The street with labels that end the road 25 cm before its kerb and 25 cm behind it, by turns of 2 m."""

    def left(self, keyframe):
        T, label = self.T_enu_cam[keyframe], super().left(keyframe)
        v, u = np.mgrid[0 : label.shape[0], 0 : label.shape[1]].astype(np.float64)
        rays = made_ground.CAMERA.rays(np.column_stack([u.ravel(), v.ravel()])) @ T[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -T[2, 3] / rays[:, 2]
            x, y = T[0, 3] + depth * rays[:, 0], T[1, 3] + depth * rays[:, 1]
        border = KERB_AT_M + np.where(np.floor(y / 2.0) % 2 == 0, 0.25, -0.25)
        ground = np.isin(label, (CLASS_ID["road"], CLASS_ID["sidewalk"]))
        told = np.where(x > border, CLASS_ID["sidewalk"], CLASS_ID["road"]).reshape(label.shape)
        return np.where(ground, told, label).astype(np.uint8)


def seen(street):
    odometry, n = street.odometry(), street.count
    exposure = DriveExposure(np.ones(n), np.zeros(n), 255.0, 0.0)
    found = views_of(street, odometry, street, street.submaps()[0], chosen_keyframes(odometry, SETTINGS), exposure, SETTINGS)
    views = [view for _, view in found]
    raster = raster_around(views, SETTINGS.reach_m)
    return views, raster, fuse(gather(views, raster, street.rig, 0.0, SETTINGS.reach_m), raster.shape)


@pytest.fixture(scope="module")
def street():
    return WrongLabels()


@pytest.fixture(scope="module")
def about(street):
    return seen(street)


@pytest.fixture(scope="module")
def steps(street, about):
    return find_steps(*about, street.rig, 0.0)


def east_of(street, steps):
    """East and north of the steps found."""
    there = np.isfinite(steps.at)
    xy = (steps.xy + steps.at[:, None] * steps.normals)[there]
    T = street.submaps()[0].T_enu_submap @ level_frame(street.submaps()[0])
    return se3.transform(T, np.column_stack([xy, np.zeros(len(xy))])), there


def test_a_kerb_is_found_where_it_is_though_labels_end_a_quarter_of_a_metre_off(street, steps):
    enu, there = east_of(street, steps)
    near = enu[:, 1] < 18.0
    assert near.sum() > 30
    assert np.median(np.abs(enu[near, 0] - KERB_AT_M)) < 0.03
    assert np.percentile(np.abs(enu[near, 0] - KERB_AT_M), 90) < 0.06
    assert np.median(steps.rise[there]) == pytest.approx(KERB_M, abs=0.015)


def test_level_ground_has_no_kerb_whatever_labels_say(monkeypatch):
    monkeypatch.setattr(made_ground, "KERB_M", 1e-6)
    level = WrongLabels()
    assert np.isfinite(find_steps(*seen(level), level.rig, 0.0).at).mean() < 0.05


def test_cells_beside_a_kerb_are_as_high_as_their_side(street, about, steps):
    _, raster, cells = about
    made, side = laid(steps, cells, raster)
    T = street.submaps()[0].T_enu_submap @ level_frame(street.submaps()[0])
    r, c = np.nonzero((cells.information > 0.0) & (side > 0))
    xy = raster.low + (np.column_stack([c, r]) + 0.5) * CELL_M
    before, after = (se3.transform(T, np.column_stack([xy, one.height[r, c]])) for one in (cells, made))
    near = (np.abs(after[:, 0] - KERB_AT_M) < 0.3) & (np.abs(after[:, 0] - KERB_AT_M) > 0.05) & (after[:, 1] < 18.0)
    true = np.where(after[:, 0] > KERB_AT_M, KERB_M, 0.0)
    off = [float((np.abs(one[near, 2] - true[near]) > 0.03).mean()) for one in (before, after)]
    assert off[0] > 0.05
    assert off[1] < 0.3 * off[0]
    assert (made.group[r, c][near] == np.where(true[near] > 0.0, BESIDE, ROAD)).mean() > 0.95


def test_the_sheet_calls_what_is_below_the_kerb_road_and_what_is_above_it_sidewalk(street):
    sheet = next(iter(make_sheets(street, street.odometry(), street, street.submaps())))
    T = street.submaps()[0].T_enu_submap @ sheet.T_submap_sheet
    r, c = np.nonzero(np.isfinite(sheet.height))
    enu = se3.transform(T, np.column_stack([sheet.corner_m + (np.column_stack([c, r]) + 0.5) * CELL_M, sheet.height[r, c]]))
    near = (np.abs(enu[:, 0] - KERB_AT_M) < 0.3) & (np.abs(enu[:, 0] - KERB_AT_M) > 0.05) & (enu[:, 1] > 6.0) & (enu[:, 1] < 16.0)
    true = np.where(enu[near, 0] > KERB_AT_M, CLASS_ID["sidewalk"], CLASS_ID["road"])
    assert (sheet.label[r, c][near] == true).mean() > 0.97


def test_votes_go_to_the_side_and_no_vote_is_lost():
    votes = np.array([[[3.0, 1.0, 2.0, 0.5], [3.0, 1.0, 2.0, 0.5], [3.0, 0.0, 0.0, 0.5], [3.0, 1.0, 2.0, 0.5]]], np.float32)
    given = votes.copy()
    give_to_sides(given, np.array([[ROAD, BESIDE, BESIDE, 0]], np.uint8))
    np.testing.assert_array_equal(given[0], [[6, 0, 0, 0.5], [0, 1, 5, 0.5], [0, 3, 0, 0.5], [3, 1, 2, 0.5]])


def test_windows_sum_stations_of_their_own_border_only():
    values = np.array([1.0, 10.0, 100.0, 1000.0, 10000.0])
    np.testing.assert_array_equal(windowed(values, np.array([0, 2, 5]), 1), [11.0, 11.0, 1100.0, 11100.0, 11000.0])


def test_the_best_step_is_the_vertex_of_the_costs_around_it_and_flat_ground_has_none():
    shifts = np.arange(-4, 5) * 0.05
    k, z = np.meshgrid(shifts, RISES_M, indexing="ij")
    costs = np.stack([100.0 + 900.0 * (k - 0.06) ** 2 + 4000.0 * (z - 0.13) ** 2, np.full(k.shape, 100.0)])
    at, rise, gain = best_steps(costs, np.full(2, 1000.0), shifts)[0]
    assert (at, rise) == (pytest.approx(0.06), pytest.approx(0.13))
    assert gain == pytest.approx(1.0 - 100.0 / costs[0, :, :2].min(), abs=0.01)
    assert np.isnan(best_steps(costs, np.full(2, 1000.0), shifts)[1]).all()
