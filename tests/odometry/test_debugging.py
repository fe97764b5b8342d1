"""What `--debug` writes, and that it changes nothing."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_street import MadeLog, curve

from wayloom.odometry.debugging import pictures
from wayloom.odometry.debugging.recorder import ENERGIES_FILE, FRAMES_FILE, KEYFRAMES_FOLDER, DebugRecorder
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking.alignment import Reference
from wayloom.odometry.types import OdometryResult


def blank(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return left * 0, right * 0


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, OdometryResult, OdometryResult]:
    """The folder, the result with it and the one without."""
    folder = tmp_path_factory.mktemp("debug") / "new"
    log = MadeLog(curve(10), changes={5: blank})
    return folder, track(log, observers=(DebugRecorder(folder),)), track(log)


def table(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / name).open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_looking_changes_no_bit_of_the_result(written) -> None:
    _, looked_at, alone = written
    np.testing.assert_array_equal(looked_at.trajectory.T_world_cam, alone.trajectory.T_world_cam)
    np.testing.assert_array_equal(looked_at.points.inverse_depth, alone.points.inverse_depth)


def test_every_frame_has_a_line_that_says_what_became_of_it(written) -> None:
    folder, result, _ = written
    lines = table(folder, FRAMES_FILE)
    assert [int(line["frame"]) for line in lines] == list(range(10))
    assert (lines[5]["outcome"], lines[5]["loss"], lines[5]["rms_grey"]) == ("lost", "the image is blank", "")
    keyframes = [int(line["frame"]) for line in lines if line["outcome"] == "keyframe"]
    assert keyframes == result.keyframes.frame.tolist()
    assert all(line["keyframe_reason"] for line in lines if line["outcome"] == "keyframe")
    assert all(0 < float(line["rms_grey"]) < 20 for line in lines if line["outcome"] == "tracked")
    assert float(lines[-1]["bias_px"]) == pytest.approx(result.disparity_bias_px, rel=1e-4)
    assert all(float(line["track_ms"]) > 0 for line in lines[1:5])


def test_energies_fall_from_iteration_to_iteration(written) -> None:
    folder, result, _ = written
    lines = table(folder, ENERGIES_FILE)
    for keyframe in range(1, len(result.keyframes)):
        energies = [float(line["energy"]) for line in lines if int(line["keyframe"]) == keyframe]
        assert len(energies) == OdometrySettings().adjust_iterations + 1
        assert energies == sorted(energies, reverse=True)


def test_each_keyframe_has_a_picture_and_the_drive_its_plots(written) -> None:
    folder, result, _ = written
    assert sorted(int(file.stem) for file in (folder / KEYFRAMES_FOLDER).iterdir()) == result.keyframes.frame.tolist()
    picture = cv2.imread(str(folder / KEYFRAMES_FOLDER / f"{result.keyframes.frame[1]:06d}.jpg"))
    assert picture.shape == (400, 720, 3)
    colour = picture.max(axis=2).astype(int) - picture.min(axis=2)
    assert (colour[20:200, :320] > 80).sum() > 1000  # depths
    assert (colour[220:, :320] > 80).sum() > 1000  # residuals
    for name in ("drive.png", "row_field.png"):
        assert cv2.imread(str(folder / name)).std() > 5


def test_residuals_are_those_of_the_image_at_the_projected_points() -> None:
    image = np.random.default_rng(0).integers(0, 255, (40, 60)).astype(np.uint8)
    points = np.array([[0.1, -0.1, 0.2, 100.0], [0.0, 0.2, 0.1, 50.0], [5.0, 0.0, 0.1, 9.0]])
    T = np.eye(4)
    T[0, 3] = 0.5
    camera = np.array([50.0, 50.0, 30.0, 20.0])
    uv, residual = pictures.residuals(image, Reference(0, [points]), T, np.array([1.1, 2.0]), camera)
    np.testing.assert_allclose(uv, [[40.0, 15.0], [32.5, 30.0]])
    expected = [image[15, 40] - 112.0, 0.5 * (int(image[30, 32]) + int(image[30, 33])) - 57.0]
    np.testing.assert_allclose(residual, expected, atol=0.3)
