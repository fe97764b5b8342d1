"""The labels of a drive's keyframes: resumable, whole files only, read back lazily."""

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_network import IDS, THREE, ids_network, logits_network, put

from wayloom.errors import StageError
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog
from wayloom.segmentation.catalogue import find_model
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.segmentation.network import Labelled, Network
from wayloom.segmentation.overlay import overlay
from wayloom.segmentation.stage import segment_keyframes

KEYFRAMES = (0, 9, 21)


class CountingNetwork(Network):
    """A network that counts its images."""

    images = 0

    def label_images(self, images: Sequence[np.ndarray], k: int = 4) -> list[Labelled]:
        self.images += len(images)
        return super().label_images(images, k)


@pytest.fixture
def network(tmp_path: Path) -> CountingNetwork:
    return CountingNetwork(find_model(put(tmp_path, "made", logits_network(pool=4), THREE)))


@pytest.fixture(scope="module")
def log(clip_b: Path) -> DriveLog:
    return open_log(clip_b)


def test_left_and_right_of_every_keyframe_are_labelled(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    labels = segment_keyframes(log, KEYFRAMES, network, tmp_path / "out")
    assert network.images == 6
    assert len(labels) == 3
    frame = log.frame(9)
    assert np.array_equal(labels.left(1), network.labels(frame.left))
    assert np.array_equal(labels.right(1), network.labels(frame.right))
    written = sorted(str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*") if p.is_file())
    assert written == [
        "left/0000000000.png", "left/0000000009.png", "left/0000000021.png",
        "left_scores/0000000000.bin", "left_scores/0000000009.bin", "left_scores/0000000021.bin",
        "left_small/0000000000.npy", "left_small/0000000009.npy", "left_small/0000000021.npy", "model.json",
        "right/0000000000.png", "right/0000000009.png", "right/0000000021.png",
        "right_scores/0000000000.bin", "right_scores/0000000009.bin", "right_scores/0000000021.bin",
        "right_small/0000000000.npy", "right_small/0000000009.npy", "right_small/0000000021.npy",
    ]  # fmt: skip
    facts = json.loads((tmp_path / "out" / "model.json").read_text())
    assert (facts["name"], facts["sha256"], facts["licence"]) == ("made", network.sha256, "unknown")


def test_right_images_that_do_not_vote_are_not_labelled(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    labels = segment_keyframes(log, KEYFRAMES, network, tmp_path / "out", right=np.array([True, False, True]))
    assert network.images == 5
    assert [labels.sides(row) for row in range(3)] == [("left", "right"), ("left",), ("left", "right")]
    for folder in ("right", "right_small", "right_scores"):
        assert sorted(path.stem for path in (tmp_path / "out" / folder).iterdir()) == ["0000000000", "0000000021"]
    assert np.array_equal(labels.left(1), network.labels(log.frame(9).left))


def test_a_second_run_labels_only_what_is_missing_or_torn(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    out = tmp_path / "out"
    segment_keyframes(log, KEYFRAMES, network, out)
    before = {path: path.read_bytes() for path in out.rglob("0*.*")}
    (out / "left" / "0000000009.png").unlink()
    torn = out / "right_scores" / "0000000021.bin"
    torn.write_bytes(torn.read_bytes()[:200])
    network.images = 0
    segment_keyframes(log, KEYFRAMES, network, out)
    assert network.images == 4
    assert {path: path.read_bytes() for path in out.rglob("0*.*")} == before


def test_what_was_labelled_ahead_is_moved_in_and_the_rest_made(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    segment_keyframes(log, KEYFRAMES, network, tmp_path / "as ever", right=np.array([True, False, True]))
    ahead = tmp_path / "ahead"
    segment_keyframes(log, (0, 9, 15), network, ahead)  # frame 15 is no keyframe in the end, the right image of 9 does not vote
    network.images = 0
    segment_keyframes(log, KEYFRAMES, network, tmp_path / "out", right=np.array([True, False, True]), ahead=ahead)
    assert network.images == 2
    assert contents(tmp_path / "out") == contents(tmp_path / "as ever")
    assert sorted(path.stem for path in (ahead / "left").iterdir()) == ["0000000015"]


def test_nothing_is_moved_in_that_another_network_labelled(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    other = Network(find_model(put(tmp_path, "other", logits_network(classes=4), THREE.replace("10]", "10, 0]"))))
    segment_keyframes(log, KEYFRAMES, other, tmp_path / "ahead")
    segment_keyframes(log, KEYFRAMES, network, tmp_path / "out", ahead=tmp_path / "ahead")
    assert network.images == 6
    assert json.loads((tmp_path / "out" / "model.json").read_text())["name"] == "made"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_another_network_labels_everything_anew(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    out = tmp_path / "out"
    segment_keyframes(log, KEYFRAMES, network, out)
    (out / "left" / "0000000077.png").write_bytes(b"of a keyframe that is no more")
    other = CountingNetwork(find_model(put(tmp_path, "other", logits_network(classes=4), THREE.replace("10]", "10, 0]"))))
    segment_keyframes(log, KEYFRAMES, other, out)
    assert other.images == 6
    assert json.loads((out / "model.json").read_text())["name"] == "other"
    assert len(list((out / "left").iterdir())) == 3


def test_scores_lie_beside_the_labels_of_a_network_that_gives_them(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    labels = segment_keyframes(log, KEYFRAMES, network, tmp_path / "out")
    expected = network.scores(log.frame(9).right)
    found = labels.scores("right", 1)
    assert found is not None
    assert np.array_equal(found.classes, expected.classes)
    assert np.array_equal(found.steps, expected.steps)
    assert found.covered == expected.covered
    (tmp_path / "out" / "right_scores" / "0000000009.bin").write_bytes(b"torn")
    with pytest.raises(StageError, match="right_scores"):
        labels.scores("right", 1)
    bare = Network(find_model(put(tmp_path, "bare", ids_network(64), IDS)))
    assert segment_keyframes(log, KEYFRAMES[:1], bare, tmp_path / "out").scores("right", 0) is None
    assert not (tmp_path / "out" / "right_scores").exists()


def test_labels_stay_in_memory_only_within_the_bound(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    segment_keyframes(log, KEYFRAMES, network, tmp_path / "out")
    labels = KeyframeLabels(tmp_path / "out", KEYFRAMES, held=2)
    first = labels.left(0)
    assert labels.left(0) is first
    labels.left(1)
    labels.left(2)
    assert labels.left(0) is not first
    assert np.array_equal(labels.left(0), first)


def test_whether_a_pixel_may_be_void_is_known_of_the_network(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    assert not segment_keyframes(log, KEYFRAMES[:1], network, tmp_path / "out").may_be_void
    partly = Network(find_model(put(tmp_path, "partly", logits_network(classes=3), THREE.replace("10]", "255]"))))
    assert segment_keyframes(log, KEYFRAMES[:1], partly, tmp_path / "out").may_be_void
    (tmp_path / "out" / "model.json").write_text("torn")
    assert KeyframeLabels(tmp_path / "out", KEYFRAMES[:1]).may_be_void


def test_whether_rare_classes_were_weighed_is_known_of_the_network(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    assert not segment_keyframes(log, KEYFRAMES[:1], network, tmp_path / "out").is_balanced
    balanced = Network(find_model(put(tmp_path, "balanced", logits_network(classes=3), THREE + "\nbalanced = true\n")))
    assert segment_keyframes(log, KEYFRAMES[:1], balanced, tmp_path / "out").is_balanced
    (tmp_path / "out" / "model.json").write_text("[]")
    assert not KeyframeLabels(tmp_path / "out", KEYFRAMES[:1]).is_balanced


@pytest.mark.parametrize("content", [None, b"", b"torn"])
def test_a_missing_or_torn_small_image_names_its_file_and_is_made_again(
    content: bytes | None, log: DriveLog, network: CountingNetwork, tmp_path: Path
) -> None:
    labels = segment_keyframes(log, KEYFRAMES, network, tmp_path / "out")
    path = tmp_path / "out" / "right_small" / "0000000009.npy"
    before = labels.small("right", 1)
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(StageError, match=r"0000000009\.npy"):
        labels.small("right", 1)
    assert np.array_equal(segment_keyframes(log, KEYFRAMES, network, tmp_path / "out").small("right", 1), before)


@pytest.mark.parametrize("content", [None, b"", b"torn"])
def test_a_missing_or_torn_label_image_names_its_file(
    content: bytes | None, log: DriveLog, network: CountingNetwork, tmp_path: Path
) -> None:
    labels = segment_keyframes(log, KEYFRAMES, network, tmp_path / "out")
    path = tmp_path / "out" / "left" / "0000000009.png"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(StageError, match=r"0000000009\.png"):
        labels.left(1)


def test_progress_rises_to_one(log: DriveLog, network: CountingNetwork, tmp_path: Path) -> None:
    shares: list[float] = []
    segment_keyframes(log, KEYFRAMES, network, tmp_path / "out", lambda share, what: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_label_is_blended_over_its_pixel_and_void_leaves_it() -> None:
    image = np.array([[100, 200]], np.uint8)
    blended = overlay(image, np.array([[0, 255]], np.uint8), 0.5)
    assert blended.tolist() == [[[114, 82, 114], [200, 200, 200]]]
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    assert np.array_equal(overlay(np.asarray(colour, np.uint8), np.array([[0, 255]], np.uint8), 0.5), blended)
