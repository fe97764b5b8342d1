"""Drawing kernels against their naive twins."""

import numpy as np
import pytest

from simulation.naive import pixel_ray, ray_hits, texture_at
from wayloom.geometry import se3
from wayloom.simulation.kernels import raster, sampling, shade, shadow
from wayloom.simulation.kernels.arrays import DepthMap, TextureStack, Triangles, View
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.textures.materials import Material

WIDTH, HEIGHT = 40, 24


def soup(rng: np.random.Generator, count: int) -> Triangles:
    """Random triangles before, beside and behind a camera that looks along z, some cutting its near plane."""
    middle = rng.uniform((-6, -4, -2), (6, 4, 14), (count, 3))
    corners = (middle[:, None] + rng.normal(0, 2.0, (count, 3, 3))).astype(np.float32)
    uv = rng.uniform(0, 1, (count, 3, 2)).astype(np.float32)
    normals = np.broadcast_to(np.float32([0, 0, -1]), (count, 3, 3)).copy()
    return Triangles(corners, uv, normals, np.full(count, Material.CONCRETE, np.uint8), np.ones((count, 3), np.float32))


@pytest.fixture
def view() -> View:
    T = se3.exp(np.array([0.3, -0.2, 0.1, 0.05, -0.1, 0.2]))
    return View(30.0, 31.0, 19.3, 11.6, T)


def rendered(tri: Triangles, tex: TextureStack, view: View) -> tuple[np.ndarray, np.ndarray]:
    edges, boxes = np.empty((len(tri.corners), 9)), np.empty((len(tri.corners), 4), np.int32)
    raster.project_triangles(tri.corners, view, se3.inverse(view.T_world_cam), WIDTH, HEIGHT, edges, boxes, np.empty((3, 3)))
    inv_z, ids = np.empty((HEIGHT, WIDTH), np.float32), np.empty((HEIGHT, WIDTH), np.int32)
    raster.rasterise(edges, boxes, tri, tex, inv_z, ids)
    return inv_z, ids


def test_each_pixel_sees_the_triangle_that_its_ray_meets_first(world: World, view: View) -> None:
    tri = soup(np.random.default_rng(1), 60)
    inv_z, ids = rendered(tri, world.textures, view)
    different = 0
    for v in range(HEIGHT):
        for u in range(WIDTH):
            depths = ray_hits(view.T_world_cam[:3, 3], pixel_ray(u, v, *view), tri.corners.astype(float))
            depths[depths < raster.NEAR_M] = np.inf
            nearest = int(np.argmin(depths)) if np.isfinite(depths).any() else raster.NO_TRIANGLE
            if ids[v, u] != nearest:
                different += 1
                continue
            if nearest != raster.NO_TRIANGLE:
                assert 1.0 / inv_z[v, u] == pytest.approx(depths[nearest], rel=1e-4)
    assert different <= 3  # rays that graze an edge


def test_a_ground_whose_edges_run_along_the_image_rows_has_no_holes(world: World) -> None:
    corners = np.float32([[[-40, 1.6, -40], [40, 1.6, -40], [40, 1.6, 40]], [[-40, 1.6, -40], [40, 1.6, 40], [-40, 1.6, 40]]])
    tri = soup(np.random.default_rng(9), 2)._replace(corners=corners)
    for turn in np.linspace(0, 2 * np.pi, 17):
        T = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, turn, 0.0]))
        T[:3, 3] = -5.88, 0.0, 0.0
        _, ids = rendered(tri, world.textures, View(30.0, 30.0, 19.5, 2.5, T))
        assert np.all(ids[5:] != raster.NO_TRIANGLE)


def test_depth_of_a_pixel_is_that_of_its_ray_and_zero_where_nothing_is_seen(world: World, view: View) -> None:
    tri = soup(np.random.default_rng(2), 30)
    _, ids = rendered(tri, world.textures, view)
    depth = np.empty(ids.shape, np.float32)
    raster.depth_of(ids, view, tri.corners, depth)
    assert np.all(depth[ids == raster.NO_TRIANGLE] == 0)
    seen, missed = np.argwhere(ids != raster.NO_TRIANGLE)[::7], 0
    for v, u in seen:
        ray = pixel_ray(u, v, *view)
        expected = ray_hits(view.T_world_cam[:3, 3], ray, tri.corners[ids[v, u]][None].astype(float))[0]
        missed += not np.isfinite(expected)
        assert not np.isfinite(expected) or depth[v, u] == pytest.approx(expected, rel=1e-5)
    assert missed <= 0.02 * len(seen)  # rays that graze an edge
    assert len(seen) > 20


def test_a_triangle_behind_the_camera_is_not_drawn(world: World) -> None:
    corners = np.float32([[[-1, -1, -5], [1, -1, -5], [0, 1, -5]]])
    tri = soup(np.random.default_rng(3), 1)._replace(corners=corners)
    _, ids = rendered(tri, world.textures, View(30.0, 30.0, 20.0, 12.0, np.eye(4)))
    assert np.all(ids == raster.NO_TRIANGLE)


def test_holes_of_a_cut_out_material_let_the_background_through(world: World) -> None:
    corners = np.float32([[[-6, -6, 5], [6, -6, 5], [6, 6, 5]], [[-6, -6, 5], [6, 6, 5], [-6, 6, 5]]])
    uv = np.float32([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    plain = soup(np.random.default_rng(4), 2)._replace(corners=corners, uv=uv)
    cut = plain._replace(material=np.full(2, Material.SPOKES, np.uint8))
    view = View(20.0, 20.0, 19.5, 11.5, np.eye(4))
    assert np.all(rendered(plain, world.textures, view)[1] >= 0)
    seen = rendered(cut, world.textures, view)[1] >= 0
    assert 0.02 < seen.mean() < 0.7


def test_bilinear_equals_the_naive_look_up_and_wraps_around(world: World) -> None:
    tex, rng = world.textures, np.random.default_rng(5)
    for _ in range(50):
        layer, level = int(rng.integers(len(Material))), int(rng.integers(0, 5))
        u, v = rng.uniform(-2, 2, 2)
        size = tex.size >> level
        got = sampling.bilinear(tex.texels, int(tex.offsets[level]) + layer * size * size, size, u, v)
        np.testing.assert_allclose(got, texture_at(tex, layer, level, u, v), atol=2e-5)


def test_a_footprint_of_one_texel_reads_the_finest_level_and_of_the_whole_texture_its_mean(world: World) -> None:
    tex, texel = world.textures, 1.0 / world.textures.size
    fine = sampling.anisotropic(tex, int(Material.BRICK), 0.31, 0.62, texel, 0.0, 0.0, texel)
    np.testing.assert_allclose(fine, texture_at(tex, Material.BRICK, 0, 0.31, 0.62), atol=2e-5)
    whole = sampling.anisotropic(tex, int(Material.BRICK), 0.31, 0.62, 1.0, 0.0, 0.0, 1.0)
    image = tex.texels[Material.BRICK * tex.size**2 : (Material.BRICK + 1) * tex.size**2, :3].astype(float) / 255
    np.testing.assert_allclose(whole[:3], (image**2).mean(axis=0), atol=0.01)


def test_a_long_footprint_is_read_along_its_long_axis_only(world: World) -> None:
    tex, texel = world.textures, 1.0 / world.textures.size
    got = np.array(sampling.anisotropic(tex, int(Material.SHOP), 0.4, 0.5, 4 * texel, 0.0, 0.0, texel))
    taps = [texture_at(tex, Material.SHOP, 0, 0.4 + 4 * texel * ((k + 0.5) / 4 - 0.5), 0.5) for k in range(4)]
    np.testing.assert_allclose(got, np.mean(taps, axis=0), atol=2e-5)


def test_noise_is_bilinear_and_tiles() -> None:
    field = np.random.default_rng(6).normal(size=(8, 8)).astype(np.float32)
    assert sampling.noise(field, 3 / 8, 5 / 8) == pytest.approx(field[5, 3])
    assert sampling.noise(field, 1.0 + 3.5 / 8, -1.0) == pytest.approx((field[0, 3] + field[0, 4]) / 2, rel=1e-6)


def test_depth_along_an_axis_is_the_largest_coordinate_over_each_texel(world: World) -> None:
    rng = np.random.default_rng(7)
    tri = soup(rng, 25)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0].astype(np.float32)
    values = np.full((20, 20), shadow.EMPTY_M, np.float32)
    shadow.draw_depth(tri, world.textures, axes, -5.0, -5.0, 2.0, values, np.empty((3, 3)))
    local = tri.corners.astype(float) @ axes.T.astype(float)
    for y in range(20):
        for x in range(20):
            origin = np.array([-5 + (x + 0.5) / 2, -5 + (y + 0.5) / 2, -100.0])
            p0, e1, e2 = local[:, 0], local[:, 1] - local[:, 0], local[:, 2] - local[:, 0]
            det = e1[:, 0] * e2[:, 1] - e2[:, 0] * e1[:, 1]
            s = origin - p0
            l1, l2 = (s[:, 0] * e2[:, 1] - e2[:, 0] * s[:, 1]) / det, (e1[:, 0] * s[:, 1] - s[:, 0] * e1[:, 1]) / det
            inside = (l1 >= 0) & (l2 >= 0) & (l1 + l2 <= 1)
            z = p0[:, 2] + l1 * e1[:, 2] + l2 * e2[:, 2]
            expected = z[inside].max() if inside.any() else shadow.EMPTY_M
            assert values[y, x] == pytest.approx(expected, abs=1e-3)


def test_a_point_under_a_roof_is_dark_and_outside_of_the_map_unknown() -> None:
    values = np.full((8, 8), shadow.EMPTY_M, np.float32)
    values[:, :4] = 10.0
    roof = DepthMap(values, 0.0, 0.0, 1.0)
    axes = np.eye(3, dtype=np.float32)
    assert shadow.lit_share(roof, axes, 2.0, 4.0, 3.0, 0.05) == 0.0
    assert shadow.lit_share(roof, axes, 6.0, 4.0, 3.0, 0.05) == 1.0
    assert shadow.lit_share(roof, axes, 4.0, 4.0, 3.0, 0.05) == pytest.approx(0.5)
    assert shadow.lit_share(roof, axes, 40.0, 4.0, 3.0, 0.05) == -1.0


def test_open_ground_sees_the_whole_sky_and_a_yard_little_of_it() -> None:
    flat = np.zeros((61, 61), np.float32)
    openness = np.empty_like(flat)
    shadow.measure_openness(flat, flat, 4.0, openness)
    assert np.all(openness == 1.0)
    walls = np.full_like(flat, 12.0)
    walls[26:35, 26:35] = 0.0
    shadow.measure_openness(walls, flat, 4.0, openness)
    assert openness[30, 30] < 0.35


def test_the_meeting_of_ray_and_triangle_and_its_pixel_steps_are_exact(view: View) -> None:
    tri = soup(np.random.default_rng(8), 40)
    tested = 0
    for t in range(len(tri.corners)):
        centre = tri.corners[t].mean(axis=0).astype(float)
        in_cam = se3.transform(se3.inverse(view.T_world_cam), centre[None])[0]
        if in_cam[2] < 1.0:
            continue
        u, v = view.fx * in_cam[0] / in_cam[2] + view.cx, view.fy * in_cam[1] / in_cam[2] + view.cy
        depth, l1, l2, l1x, l2x, l1y, l2y = shade.meet(tri, t, view, *pixel_ray(u, v, *view))
        assert (depth, l1, l2) == pytest.approx((in_cam[2], 1 / 3, 1 / 3), rel=2e-3)
        right, below = shade.meet(tri, t, view, *pixel_ray(u + 1, v, *view)), shade.meet(tri, t, view, *pixel_ray(u, v + 1, *view))
        if right[0] > 0 and below[0] > 0 and right[0] < 3 * depth and below[0] < 3 * depth:
            assert (l1 + l1x, l2 + l2x, l1 + l1y, l2 + l2y) == pytest.approx(
                (right[1], right[2], below[1], below[2]), rel=1e-3, abs=1e-4
            )
            tested += 1
    assert tested > 10


def test_a_pixel_is_the_mean_of_what_its_samples_see(world: World, poses: list[np.ndarray]) -> None:
    from wayloom.simulation.vehicle.rigs import sized_rig

    camera, T = sized_rig("quarter").camera, poses[0]
    scene = world.scene(camera, T, 1.0)
    view = View(camera.fx, camera.fy, camera.cx, camera.cy, T)
    tri = scene.mesh.triangles()
    ids = np.full((4, 4), raster.NO_TRIANGLE, np.int32)
    t = int(np.argmax(scene.mesh.material == Material.STREET))
    ids[0, 0] = ids[0, 1] = t  # the upper half of pixel (0, 0)
    out = np.empty((2, 2, 3), np.float32)
    shade.shade_samples(ids, tri, scene.textures, scene.light, view, out, np.empty((2, 4), np.int32), np.empty((2, 4)))
    upper = np.array(shade.pixel_colour(t, 0.0, -0.25, tri, scene.textures, scene.light, view))
    lower = np.array(shade.pixel_colour(raster.NO_TRIANGLE, 0.0, 0.25, tri, scene.textures, scene.light, view))
    np.testing.assert_allclose(out[0, 0], 0.5 * (upper + lower), rtol=1e-5)
    sky = np.array(shade.pixel_colour(raster.NO_TRIANGLE, 1.0, 1.0, tri, scene.textures, scene.light, view))
    np.testing.assert_allclose(out[1, 1], sky, rtol=1e-6)
