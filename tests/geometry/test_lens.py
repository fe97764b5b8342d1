import numpy as np
import pytest

from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import (
    IDENTITY,
    PARAMETERS,
    RightLens,
    at_infinity,
    displaced,
    lens_field,
    lens_from_values,
    parameter_jacobian,
    project_scaled,
    projection_jacobians,
)

CAMERA = PinholeCamera(718.9, 715.2, 607.2, 185.2, 1241, 376)
BASELINE_M = 0.537
LENS = RightLens(1e-3, -2e-3, 1.5e-3, 3e-3, -4e-3, 1.002, -0.7, 0.01, -1e-3, 2e-3)
SMALL = np.array([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-6, 1e-4, 1e-5, 1e-6, 1e-6])


def pixels_and_depths(count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.uniform((0, 0), (1240, 375), (count, 2)), rng.uniform(0, 0.4, count)


def test_the_default_lens_changes_nothing() -> None:
    uv, rho = pixels_and_depths()
    np.testing.assert_allclose(RightLens().real_pixels(CAMERA, BASELINE_M, uv, rho), uv, atol=1e-10)
    assert IDENTITY.is_ideal
    assert not LENS.is_ideal


def test_a_point_is_where_rotation_displacement_and_lens_put_it() -> None:
    p = np.array([1.0, 0.5, 6.0])
    cx, sx, cy, sy, cz, sz = (f(a) for a in (1e-3, -2e-3, 1.5e-3) for f in (np.cos, np.sin))
    Rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    Rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    x, y, z = Rz @ Ry @ Rx @ (p + BASELINE_M * np.array([0, 3e-3, -4e-3]))
    x, y = x / z, y / z
    r2 = x * x + y * y
    xd = x * (1 + 0.01 * r2) + 2 * -1e-3 * x * y + 2e-3 * (r2 + 2 * x * x)
    yd = y * (1 + 0.01 * r2) + -1e-3 * (r2 + 2 * y * y) + 2 * 2e-3 * x * y
    expected = [1.002 * CAMERA.fx * xd + CAMERA.cx - 0.7, 1.002 * CAMERA.fy * yd + CAMERA.cy]
    np.testing.assert_allclose(LENS.real_pixels(CAMERA, BASELINE_M, CAMERA.project(p[None]), 1 / 6.0)[0], expected, atol=1e-9)


def test_ideal_pixels_undo_real_pixels_at_every_depth() -> None:
    uv, rho = pixels_and_depths()
    real = LENS.real_pixels(CAMERA, BASELINE_M, uv, rho)
    np.testing.assert_allclose(LENS.ideal_pixels(CAMERA, BASELINE_M, real, rho), uv, atol=1e-6)


@pytest.mark.parametrize("lens", [IDENTITY, LENS])
@pytest.mark.parametrize("name", PARAMETERS)
def test_the_parameters_jacobian_is_that_of_finite_differences(lens: RightLens, name: str) -> None:
    uv, rho = pixels_and_depths(50)
    i = PARAMETERS.index(name)
    step = np.eye(10)[i] * SMALL[i]
    ahead, behind = (lens_from_values(lens.values + sign * step).real_pixels(CAMERA, BASELINE_M, uv, rho) for sign in (1, -1))
    numeric = (ahead - behind) / (2 * SMALL[i])
    analytic = parameter_jacobian(lens, CAMERA, BASELINE_M, uv, rho)[:, :, i]
    np.testing.assert_allclose(analytic, numeric, atol=2e-6 * np.abs(numeric).max() + 1e-6)


def test_the_points_jacobians_are_those_of_finite_differences() -> None:
    uv, rho = pixels_and_depths(50)
    q = CAMERA.rays(uv) * np.linspace(0.7, 1.3, 50)[:, None]
    by_q, by_rho, _ = projection_jacobians(LENS, CAMERA, BASELINE_M, q, rho)

    def project(q: np.ndarray, rho: np.ndarray) -> np.ndarray:
        return project_scaled(LENS, CAMERA, BASELINE_M, q, rho)

    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        np.testing.assert_allclose(by_q[:, :, k], (project(q + step, rho) - project(q - step, rho)) / 2e-6, atol=1e-3)
    np.testing.assert_allclose(by_rho, (project(q, rho + 1e-6) - project(q, rho - 1e-6)) / 2e-6, atol=1e-3)


def test_a_displaced_rig_and_a_lens_at_infinity_are_the_whole_lens_at_every_depth() -> None:
    rig = StereoRig(CAMERA, (-BASELINE_M, 0.002, -0.001))
    points = np.random.default_rng(2).uniform((-8, -2, 4), (8, 2, 40), (100, 3))
    ideal = points + rig.t_right_left
    whole = project_scaled(LENS, CAMERA, rig.baseline_m, ideal, np.ones(100))
    in_warped = CAMERA.project(points + displaced(rig, LENS).t_right_left)
    np.testing.assert_allclose(at_infinity(LENS).real_pixels(CAMERA, 0.0, in_warped), whole, atol=1e-9)


def test_the_field_is_the_first_order_sum_of_the_docstring() -> None:
    tiny = lens_from_values(IDENTITY.values + 1e-4 * np.array([1, 2, -1, 0, 0, 3, 100, 2, 1, -2]))
    field = lens_field(tiny, CAMERA, step=25)
    v, u = np.mgrid[0:376:25, 0:1241:25]
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    r2 = x * x + y * y
    du = 2 * (1 + x**2) - x * y + y + 3 * x + 2 * x * r2 + 2 * x * y - 2 * (r2 + 2 * x**2)
    dv = -(1 + y**2) + 2 * x * y - x + 3 * y + 2 * y * r2 + (r2 + 2 * y**2) - 4 * x * y
    np.testing.assert_allclose(field[..., 0], 1e-4 * CAMERA.fx * du + 0.01, atol=2e-3)
    np.testing.assert_allclose(field[..., 1], 1e-4 * CAMERA.fy * dv, atol=2e-3)


def test_a_point_behind_the_real_camera_is_nan() -> None:
    assert np.isnan(project_scaled(LENS, CAMERA, BASELINE_M, np.array([[0.0, 0.0, -1.0]]), np.array([0.1]))).all()
