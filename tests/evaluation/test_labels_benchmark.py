"""`wayloom benchmark labels` on a small drive of the simulator in KITTI-360's layout, LiDAR included."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.errors import InputError
from wayloom.evaluation.label_consistency import consistency
from wayloom.evaluation.label_pictures import best_keyframes, write_figure
from wayloom.evaluation.label_truth import find_labelled_drives
from wayloom.evaluation.labels import ROWS, LabelBenchmark, LabelledPoints, benchmark_labels, labels_folder
from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS
from wayloom.segmentation.network import Network
from wayloom.segmentation.stage import KeyframeLabels
from wayloom.simulation.simulate import simulate


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    simulate("benchmark", folder, "quarter", format="kitti-360", truth=True, drives=("seq-0",), frames=14)
    return folder


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def done(dataset: Path, work: Path) -> tuple[LabelBenchmark, LabelledPoints]:
    shown: list[LabelledPoints] = []
    drives = find_labelled_drives(dataset, "kitti-360")
    return benchmark_labels(drives, Network(MODELS[DEFAULT_MODEL]), work_dir=work, show=shown.append), shown[0]


def test_every_row_is_judged_on_the_same_points_and_every_point_is_counted_once(
    done: tuple[LabelBenchmark, LabelledPoints],
) -> None:
    result, labelled = done
    assert tuple(result.rows) == ROWS
    assert len({row.points for row in result.rows.values()}) == 1
    assert result.rows["best"].points == result.filters["kept"] > 100
    assert result.rows_with_boundaries["best"].points == result.filters["kept"] + result.filters["boundary"]
    assert sum(result.filters.values()) == len(labelled.odometry.points)
    assert result.filters["no LiDAR point near"] > 0


def test_the_truth_is_that_of_the_image_at_the_point(done: tuple[LabelBenchmark, LabelledPoints]) -> None:
    _, labelled = done
    points, matches = labelled.odometry.points, labelled.matches
    for p in np.flatnonzero(matches.judged)[::20].tolist():
        frame = labelled.drive.truth.frame(int(labelled.odometry.keyframes.frame[points.host[p]]))
        assert frame is not None
        u, v = np.floor(points.uv_host[p] + 0.5).astype(int)
        assert frame.image[v, u] == matches.truth[p]


def test_the_clouds_and_the_drawn_depth_judge_alike(done: tuple[LabelBenchmark, LabelledPoints], dataset: Path, work: Path) -> None:
    by_clouds, labelled = done
    shown: list[LabelledPoints] = []
    drawn = find_labelled_drives(dataset, "drawn")
    assert [drive.name for drive in drawn] == ["seq-0"]
    by_pixels = benchmark_labels(drawn, Network(MODELS[DEFAULT_MODEL]), work_dir=work, show=shown.append)
    both = labelled.matches.judged_with_boundaries & shown[0].matches.judged_with_boundaries
    assert both.sum() > 0.8 * labelled.matches.judged_with_boundaries.sum()
    assert (labelled.matches.truth == shown[0].matches.truth)[both].all()
    for row in ROWS:
        # The scanner sees fewer points than the camera: the accuracies differ by chance, as shares of some hundred points do.
        sigma = 100 / np.sqrt(by_clouds.rows_with_boundaries[row].points)
        assert by_clouds.rows_with_boundaries[row].oa == pytest.approx(by_pixels.rows_with_boundaries[row].oa, abs=3 * sigma)


def test_the_picture_shows_truth_image_and_vote_of_each_keyframe(done: tuple[LabelBenchmark, LabelledPoints]) -> None:
    _, labelled = done
    keyframes = best_keyframes(labelled, 2)
    assert keyframes == sorted(set(keyframes))
    data = write_figure(labelled, "figure.png", 2)
    assert data is not None
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    camera = labelled.odometry.rig.camera
    assert picture.shape[:2] == (3 * (camera.height + 22), len(keyframes) * camera.width)


def test_labels_of_neighbours_agree_more_after_the_vote(done: tuple[LabelBenchmark, LabelledPoints], work: Path) -> None:
    _, labelled = done
    frames = labelled.odometry.keyframes.frame
    images = KeyframeLabels(labels_folder(work / labelled.drive.name, Network(MODELS[DEFAULT_MODEL])), frames)
    measured = consistency(labelled.odometry, images, labelled.labels)
    assert measured.steps > 1000
    assert 0 < measured.flips < 0.3
    assert measured.disagreement["best"] < measured.disagreement["baseline"]


def test_the_command_writes_what_scripts_rely_on(dataset: Path, work: Path, tmp_path: Path) -> None:
    outputs = {"--json": "t.json", "--csv": "t.csv", "--latex": "t.tex", "--picture": "t.jpg"}
    options = [part for name, file in outputs.items() for part in (name, str(tmp_path / file))]
    command = [sys.executable, "-m", "wayloom.cli.main", "benchmark", "labels", str(dataset), "--work", str(work), *options]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert "TCL stereo" in told.stdout
    content = json.loads((tmp_path / "t.json").read_text())
    assert set(content["rows"]) == set(ROWS)
    for row in content["rows"].values():
        assert 0 < row["miou"] <= 100
        assert 0 < row["oa"] <= 100
        assert set(row["iou"]) <= set(row["accuracy"]) | set(row["iou"])
    assert content["filters"]["kept"] > 0
    assert all((tmp_path / file).stat().st_size > 100 for file in outputs.values())


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["none"], "no such folder"),
        (["."], "nothing labelled"),
        ([".", "--frames", "9:3"], "--frames"),
        ([".", "--model", "x"], "x"),
    ],
)
def test_what_cannot_be_measured_is_told_in_one_line(arguments: list[str], fault: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "wayloom.cli.main", "benchmark", "labels", *arguments]
    told = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert told.returncode == 2
    assert told.stderr.count("\n") == 1
    assert fault in told.stderr


def test_a_part_of_a_drive_knows_its_own_frames(dataset: Path) -> None:
    whole, part = (find_labelled_drives(dataset, "kitti-360", *bounds)[0] for bounds in ((0, None), (4, 9)))
    assert len(part.log) == 5
    one, other = whole.truth.frame(5), part.truth.frame(1)
    assert one is not None
    assert other is not None
    assert np.array_equal(one.image, other.image)
    with pytest.raises(InputError, match="none from 40"):
        find_labelled_drives(dataset, "kitti-360", 40, 50)
