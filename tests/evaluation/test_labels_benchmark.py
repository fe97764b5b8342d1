"""`wayloom benchmark labels` on a small drive of the simulator in KITTI-360's layout, LiDAR included."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.config.classes import CLASS_NAMES, SKY
from wayloom.errors import InputError
from wayloom.evaluation.label_consistency import consistency
from wayloom.evaluation.label_pictures import best_keyframes, write_figure
from wayloom.evaluation.label_truth import DrawnTruth, ScannedTruth, find_labelled_drives
from wayloom.evaluation.labels import ROWS, LabelBenchmark, LabelledPoints, benchmark_labels, labels_folder
from wayloom.logs import simulated_truth
from wayloom.logs.simulated_truth import open_truth
from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.segmentation.network import Network
from wayloom.simulation.city import instance_ids
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    simulate(
        "benchmark", folder, OutputSettings("quarter", format="kitti-360", truth=True), PresetVariant(drives=("seq-0",), frames=28)
    )
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


def test_the_class_wise_accuracy_is_the_share_of_right_points_among_those_that_got_the_class(
    done: tuple[LabelBenchmark, LabelledPoints],
) -> None:
    result, labelled = done
    for judged, rows in (
        (labelled.matches.judged, result.rows),
        (labelled.matches.judged_with_boundaries, result.rows_with_boundaries),
    ):
        truth = labelled.matches.truth[judged]
        for row in ROWS:
            found = labelled.labels[row][judged]
            expected = {
                name: 100.0 * float((truth[found == c] == c).mean())
                for c, name in enumerate(CLASS_NAMES)
                if c != SKY and (found == c).any()
            }
            assert rows[row].accuracy == pytest.approx(expected)
            assert len(expected) > 2


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


def test_the_layout_of_kitti_360_and_the_scans_themselves_give_the_same_table(
    done: tuple[LabelBenchmark, LabelledPoints], dataset: Path, work: Path
) -> None:
    """To the last point: the clouds hold the rows that the scans give, of the same type, with poses that are read back exactly
    (the truth's are rounded to 1e-12 m, a fifty-millionth of a float32's step at 100 m)."""
    by_clouds, labelled = done
    shown: list[LabelledPoints] = []
    drives = find_labelled_drives(dataset, "scanned")
    assert isinstance(drives[0].truth, ScannedTruth)
    directly = benchmark_labels(drives, Network(MODELS[DEFAULT_MODEL]), work_dir=work, show=shown.append)
    assert directly.filters == by_clouds.filters
    assert np.array_equal(shown[0].matches.reason, labelled.matches.reason)
    assert directly.rows == by_clouds.rows
    assert directly.rows_with_boundaries == by_clouds.rows_with_boundaries


def test_label_images_are_there_when_a_drive_is_shown_though_nobody_keeps_them(dataset: Path) -> None:
    seen: list[int] = []

    def look(done: LabelledPoints) -> None:
        seen.extend(done.images.left(row).size for row in range(len(done.images)))

    benchmark_labels(find_labelled_drives(dataset, "drawn"), Network(MODELS[DEFAULT_MODEL]), show=look)
    assert len(seen) > 1
    assert all(seen)


def test_the_clouds_of_a_frame_are_its_scans_points(dataset: Path) -> None:
    clouds, scans = (find_labelled_drives(dataset, source)[0].truth for source in ("kitti-360", "scanned"))
    for index in (0, 7):
        one, other = clouds.frame(index), scans.frame(index)
        assert one is not None
        assert other is not None
        assert np.array_equal(one.labels, other.labels)
        assert np.abs(one.points_cam - other.points_cam).max() < 2 * np.spacing(np.float32(np.abs(one.points_cam).max() + 1000))
        assert np.array_equal(one.image, other.image)


def test_a_drive_with_a_lidar_is_judged_by_its_scans_in_any_layout_and_one_without_by_its_pixels(
    dataset: Path, tmp_path: Path
) -> None:
    simulate("benchmark", tmp_path / "kitti", OutputSettings("quarter", truth=True), PresetVariant(drives=("seq-0",), frames=2))
    simulate("demo", tmp_path / "demo", OutputSettings("quarter", truth=True), PresetVariant(drives=("car-1",), frames=2))
    scanned, drawn = (find_labelled_drives(tmp_path / name)[0].truth for name in ("kitti", "demo"))
    assert isinstance(scanned, ScannedTruth)
    assert isinstance(drawn, DrawnTruth)
    scan, same = open_truth(tmp_path / "kitti" / "seq-0").scan(1), open_truth(dataset / "seq-0").scan(1)
    assert scan is not None
    assert same is not None
    assert np.array_equal(scan.points_cam, same.points_cam)
    frame = scanned.frame(1)
    assert frame is not None
    assert 0.5 * len(scan.points_cam) < len(frame.points_cam) < 2 * len(scan.points_cam)  # of two scans, thinned
    with pytest.raises(InputError, match="nothing labelled"):
        find_labelled_drives(tmp_path / "demo", "scanned")


def test_the_truth_tells_what_moves_as_the_simulator_numbers_it() -> None:
    assert simulated_truth.FIRST_MOVER == instance_ids.FIRST_MOVER


def test_a_scan_that_does_not_fit_its_labels_is_named(tmp_path: Path) -> None:
    simulate("benchmark", tmp_path, OutputSettings("quarter", truth=True), PresetVariant(drives=("seq-0",), frames=2))
    file = tmp_path / "seq-0" / "velodyne" / "000000.bin"
    file.write_bytes(file.read_bytes()[:-16])
    with pytest.raises(InputError, match=r"000000\.bin.*points, their labels"):
        open_truth(tmp_path / "seq-0").scan(0)


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


@pytest.mark.parametrize("row", [row for row in ROWS if row != "baseline"])
def test_votes_are_better_than_the_single_image_by_more_than_their_noise(
    row: str, done: tuple[LabelBenchmark, LabelledPoints]
) -> None:
    """With the network that is shipped; its noise is the interval over resampled pieces of street."""
    result, _ = done
    for gains in (result.gains, result.gains_with_boundaries):
        assert gains[row].low > 0


def test_the_command_writes_what_scripts_rely_on(dataset: Path, work: Path, tmp_path: Path) -> None:
    outputs = {"--csv": "t.csv", "--latex": "t.tex", "--picture": "t.jpg"}
    options = [part for name, file in outputs.items() for part in (name, str(tmp_path / file))] + ["--json"]
    command = [
        sys.executable,
        "-m",
        "wayloom.cli.main",
        "benchmark",
        "labels",
        str(dataset),
        "--work",
        str(work),
        *options,
        "--json",
    ]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert "TCL stereo" in told.stderr
    content = json.loads(told.stdout)
    assert set(content["rows"]) == set(ROWS)
    for row in content["rows"].values():
        assert 0 < row["miou"] <= 100
        assert 0 < row["oa"] <= 100
        assert row["miou"] == pytest.approx(np.mean(list(row["iou"].values())))
        hit = {name for name, iou in row["iou"].items() if iou > 0}
        assert 0 < len(hit) <= len(row["iou"])
        assert hit <= set(row["accuracy"]) <= set(CLASS_NAMES) - {"sky"}  # a class that is found right somewhere is found
        assert all(row["accuracy"][name] >= row["iou"][name] > 0 for name in hit)
        assert all(0 <= share <= 100 for share in row["accuracy"].values())
    assert content["filters"]["kept"] > 0
    assert (tmp_path / "t.tex").read_text().count("class-wise accuracy") == 2
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
