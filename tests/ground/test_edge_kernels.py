"""Kernels of the kerbs' edges against slow twins."""

import numpy as np
import pytest

import made_ground
from wayloom.geometry import se3
from wayloom.ground.kernels.edges import add_step_costs, nearest_steps, side_planes
from wayloom.ground.view import BESIDE, ROAD

pytestmark = pytest.mark.kernels


def cost_twin(place, along, across, rises, shifts, pair, first_row, usable, camera, bf, bias, T_cam_sheet, eye, most):
    """What `add_step_costs` adds at one station, ray by ray in three dimensions."""
    x0, y0, nx, ny, z0, slope_a, slope_b = place
    costs, seen_there = np.zeros((len(shifts), len(rises))), 0.0

    def over_plane(p):
        a, b = (p[0] - x0) * nx + (p[1] - y0) * ny, -(p[0] - x0) * ny + (p[1] - y0) * nx
        return p[2] - (z0 + slope_a * a + slope_b * b)

    def bilinear(image, v, u):
        i, j, fv, fu = int(v), int(u), v - int(v), u - int(u)
        part = image[i : i + 2, j : j + 2].astype(float)
        return float(np.array([1 - fv, fv]) @ part @ np.array([1 - fu, fu]))

    for a in across:
        for b in along:
            p = np.array([x0 + a * nx - b * ny, y0 + a * ny + b * nx, z0 + slope_a * a + slope_b * b])
            cam = T_cam_sheet[:3, :3] @ p + T_cam_sheet[:3, 3]
            u, v = camera[0] * cam[0] / cam[2] + camera[2], camera[1] * cam[1] / cam[2] + camera[3] - first_row
            if not usable[round(v), round(u)]:
                continue
            over = over_plane(eye)
            weight = min(1.0, camera[0] * camera[1] * over * (along[1] - along[0]) * (across[1] - across[0]) / cam[2] ** 3)
            seen_there += weight
            eye_a = (eye[0] - x0) * nx + (eye[1] - y0) * ny
            for k, shift in enumerate(shifts):
                for h, rise in enumerate(rises):
                    # down the ray from above all steps, in small pieces, until it is in the ground
                    heights = np.linspace(rises[-1], 0.0, 4801)
                    share = heights / over
                    places = a + share * (eye_a - a)
                    below = heights <= np.where(places > shift, rise, 0.0) + 1e-12
                    z = heights[np.argmax(below)]
                    right = [bilinear(pair[1], v, u - bf / (cam[2] * (1 - rise_k / over)) - bias) for rise_k in rises]
                    table = [weight * min(abs(bilinear(pair[0], v, u) - one), most) for one in right]
                    costs[k, h] += np.interp(z, rises, table)
    return costs, seen_there


def test_costs_of_steps_are_those_of_rays_that_end_on_the_profile():
    rng = np.random.default_rng(4)
    pair = rng.uniform(-20.0, 20.0, (2, 90, 200)).astype(np.float32)
    usable = rng.random((90, 200)) < 0.8
    T_sheet_cam = made_ground.pose(0.0)
    camera, eye = np.array([200.0, 200.0, 100.0, 20.0]), T_sheet_cam[:3, 3].copy()
    places = np.array(
        [[1.5, 6.0, 1.0, 0.0, 0.01, 0.02, -0.01], [1.5, 6.0, 1.0, 0.0, np.nan, 0.0, 0.0], [1.4, 60.0, 1.0, 0.0, 0, 0, 0]]
    )
    along, across, rises, shifts = (
        np.array([-0.05, 0.0, 0.05]),
        np.arange(-3, 4) * 0.1,
        np.arange(4) * 0.08,
        np.array([-0.1, 0.0, 0.1]),
    )
    costs, found = np.zeros((3, 3, 4)), np.zeros(3)
    args = (pair, 5, usable, camera, 100.0, 0.3, se3.inverse(T_sheet_cam), eye)
    add_step_costs(places, along, across, rises, shifts, *args, 18.0, 24.0, costs, found)
    twin, twin_seen = cost_twin(places[0], along, across, rises, shifts, *args, 24.0)
    assert found[0] == pytest.approx(twin_seen)
    np.testing.assert_allclose(costs[0], twin, rtol=2e-3)
    assert not costs[1:].any()
    assert not found[1:].any()


def test_planes_beside_a_station_are_those_of_its_cells_and_outliers_bend_them_little():
    r, c = np.mgrid[0:40, 0:40]
    x, y = 0.1 * (c + 0.5), 0.1 * (r + 0.5)
    height = np.where(x < 2.0, 0.02 * (x - 2.0) - 0.01 * (y - 2.0), 0.5)
    height[20, 12] = 0.6
    group = np.where(x < 2.0, ROAD, BESIDE).astype(np.uint8)
    stations = np.array([[1.9, 2.0, 1.0, 0.0, 0.1], [1.9, 2.0, 1.0, 0.0, np.nan]])
    out, count = np.empty((2, 3)), np.zeros(2, np.int32)
    window = np.array([-1.3, -0.3, 0.7])
    side_planes(stations, height, np.ones(height.shape), group, ROAD, 0.1, np.zeros(2), window, 0.0, 0.03, 6, 20, out, count)
    np.testing.assert_allclose(out[0], [0.0, 0.02, -0.01], atol=0.002)
    assert count[0] == 10 * 14  # cells from 0.75 to 1.65 m across, and 1.35 to 2.65 m along
    assert np.isnan(out[1]).all()


def test_cells_go_to_the_nearest_step_and_none_to_a_station_without_one():
    stations = np.array([[1.0, 1.0, 1.0, 0.0, 0.2], [1.0, 1.4, 1.0, 0.0, 0.2], [2.5, 1.0, 1.0, 0.0, np.nan]])
    nearest, distance2 = np.full((30, 40), -1, np.int64), np.full((30, 40), np.inf)
    nearest_steps(stations, 0.1, np.zeros(2), 0.5, 0.3, nearest, distance2)
    for r in range(30):
        for c in range(40):
            x, y = 0.1 * (c + 0.5) - 1.2, 0.1 * (r + 0.5) - np.array([1.0, 1.4])
            inside = (abs(x) <= 0.5) & (np.abs(y) <= 0.3)
            assert nearest[r, c] == (np.argmin(np.where(inside, np.abs(y), np.inf)) if inside.any() else -1)
