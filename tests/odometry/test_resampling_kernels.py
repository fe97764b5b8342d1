import numpy as np
import pytest

from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.kernels.resampling import STEP, resample
from wayloom.odometry.rig import rows

pytestmark = pytest.mark.kernels

HEIGHT, WIDTH = 45, 83


def made_image(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


def made_corners(reach_px: float, bend_px: float, seed: int = 1) -> np.ndarray:
    """Displacements about a random one of up to reach_px, which corners differ from by bend_px."""
    rng = np.random.default_rng(seed)
    shape = (HEIGHT // STEP + 2, WIDTH // STEP + 2, 2)
    return (rng.uniform(-reach_px, reach_px, 2) + rng.uniform(-bend_px, bend_px, shape)).astype(np.float32)


def naive_weight(distance: float) -> float:
    """Keys 1981, eq. 15 with a = -0.75."""
    d, a = abs(distance), -0.75
    if d <= 1.0:
        return ((a + 2.0) * d - (a + 3.0)) * d * d + 1.0
    return ((a * d - 5.0 * a) * d + 8.0 * a) * d - 4.0 * a if d < 2.0 else 0.0


def naive_resample(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Grey values (h, w), not yet rounded."""
    h, w = image.shape
    out = np.zeros((h, w))
    for y in range(h):
        for x in range(w):
            (k, b), (c, a) = divmod(y, STEP), divmod(x, STEP)
            a, b = a / STEP, b / STEP
            upper = (1 - a) * corners[k, c].astype(float) + a * corners[k, c + 1]
            lower = (1 - a) * corners[k + 1, c].astype(float) + a * corners[k + 1, c + 1]
            u, v = (x, y) + (1 - b) * upper + b * lower
            for q in range(int(np.floor(v)) - 1, int(np.floor(v)) + 3):
                for p in range(int(np.floor(u)) - 1, int(np.floor(u)) + 3):
                    grey = float(image[min(max(q, 0), h - 1), min(max(p, 0), w - 1)])
                    out[y, x] += naive_weight(u - p) * naive_weight(v - q) * grey
    return np.clip(out, 0.0, 255.0)


@pytest.mark.parametrize(("reach_px", "bend_px"), [(0.4, 0.05), (3.0, 0.6), (6.0, 4.0), (500.0, 1.0)])
def test_a_displaced_image_is_that_of_the_naive_twin(reach_px: float, bend_px: float) -> None:
    for seed in range(3):
        image, corners = made_image(seed), made_corners(reach_px, bend_px, seed)
        np.testing.assert_allclose(resample(image, corners, 0), naive_resample(image, corners), atol=0.51)


def test_whole_pixels_move_an_image_exactly() -> None:
    image, corners = made_image(), np.zeros((HEIGHT // STEP + 2, WIDTH // STEP + 2, 2), np.float32)
    np.testing.assert_array_equal(resample(image, corners, 0), image)
    corners[:] = (3.0, -2.0)
    np.testing.assert_array_equal(resample(image, corners, 0)[2:, :-3], image[:-2, 3:])


def test_the_rows_from_one_on_are_those_of_the_whole_image() -> None:
    image, corners = made_image(), made_corners(2.0, 0.5)
    np.testing.assert_array_equal(resample(image, corners, 13), resample(image, corners, 0)[13:])


@pytest.mark.parametrize("far_px", [-(2.0**20), -500.0, 500.0, 2.0**20])
def test_a_displacement_far_outside_the_image_reads_its_border(far_px: float) -> None:
    around = np.full((3 * HEIGHT, WIDTH), 200, np.uint8)
    image = around[HEIGHT : 2 * HEIGHT]
    image[:] = 0
    corners = np.full((HEIGHT // STEP + 2, WIDTH // STEP + 2, 2), far_px, np.float32)
    np.testing.assert_array_equal(resample(image, corners, 0), 0)


@pytest.mark.parametrize("coefficient", [np.nan, np.inf, -np.inf, 1e20])
def test_rows_that_are_off_by_no_number_of_pixels_are_refused(coefficient: float) -> None:
    rig = StereoRig(PinholeCamera(80.0, 80.0, 41.0, 22.0, WIDTH, HEIGHT), (-0.5, 0.0, 0.0))
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match=r"rows and lens move pixels by (nan|inf|[0-9.]+e\+20)"):
        rows.displacements(np.array([coefficient, 0.0, 0.0]), rig)


def test_an_image_that_is_larger_than_its_displacements_is_refused() -> None:
    with pytest.raises(ValueError, match="an image of 83x45 px"):
        rows.align(made_image(), made_corners(1.0, 0.1)[:-1])


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (8, 8), (9, 16)])
def test_small_images_are_resampled(shape: tuple[int, int]) -> None:
    image = np.full(shape, 77, np.uint8)
    corners = np.full((shape[0] // STEP + 2, shape[1] // STEP + 2, 2), 0.3, np.float32)
    np.testing.assert_array_equal(resample(image, corners, 0), image)
