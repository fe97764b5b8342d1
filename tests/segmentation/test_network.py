"""A network labels every pixel, whatever the image's size, and a network that does not fit is refused before any work."""

import itertools
import os
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_network import FLOAT, IDS, PLAIN, THREE, ids_network, ids_of_any_size, logits_network, model, node, put, value

from wayloom.errors import ModelError
from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS, find_model
from wayloom.segmentation.kernels.network_input import scaled_grey, scaled_pixels, scaled_planes
from wayloom.segmentation.kernels.upsampling import upsampled_argmax
from wayloom.segmentation.network import Network
from wayloom.segmentation.onnx_file import check_onnx
from wayloom.segmentation.providers import available_devices
from wayloom.segmentation.tiling import tiles_along

CAR, VEGETATION, SKY = 13, 8, 10


def painted(height: int, width: int) -> np.ndarray:
    """Left third red, middle green, right blue."""
    image = np.zeros((height, width, 3), np.uint8)
    for c in range(3):
        image[:, c * width // 3 : (c + 1) * width // 3, c] = 200
    return image


def truth(height: int, width: int, blue: int) -> np.ndarray:
    labels = np.zeros((height, width), np.uint8)
    for c, label in enumerate((CAR, VEGETATION, blue)):
        labels[:, c * width // 3 : (c + 1) * width // 3] = label
    return labels


@pytest.mark.parametrize(("height", "width"), [(64, 96), (61, 97), (8, 8), (37, 124)])
def test_whole_frames_of_any_size_are_labelled_at_full_resolution(height: int, width: int, tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", logits_network(), THREE)))
    assert np.array_equal(network.labels(painted(height, width)), truth(height, width, SKY))


def test_logits_at_a_stride_are_brought_back_to_every_pixel(tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", logits_network(pool=4), THREE)))
    labels = network.labels(painted(60, 120))
    wrong = np.flatnonzero((labels != truth(60, 120, SKY)).any(axis=0))
    assert labels.shape == (60, 120)
    assert all(min(abs(column - 39.5), abs(column - 79.5)) < 3 for column in wrong)


@pytest.mark.parametrize(("height", "width"), [(60, 60), (60, 197), (200, 70), (64, 150)])
def test_a_network_for_squares_sees_tiles_and_labels_the_whole_frame(height: int, width: int, tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", ids_network(64), IDS)))
    labels = network.labels(painted(height, width))
    assert labels.shape == (height, width)
    assert (labels == truth(height, width, 255)).mean() > 0.97


@pytest.mark.parametrize(
    ("data", "toml"),
    [(logits_network(), THREE), (logits_network(pool=4), THREE + "zoom = 1.25\n"), (ids_network(64), IDS)],
    ids=["whole", "enlarged", "squares of bytes"],
)
def test_a_grey_image_is_taken_as_grey_colour(data: bytes, toml: str, tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", data, toml)))
    grey = np.random.default_rng(0).integers(0, 255, (43, 57)).astype(np.uint8)
    of_grey, of_colour = network.label_images([grey, np.dstack([grey] * 3)])
    assert np.array_equal(of_grey.labels, of_colour.labels)
    if network.gives_scores:
        assert np.array_equal(network.logits(grey), network.logits(np.dstack([grey] * 3)))


def test_the_best_scores_are_those_of_the_softmax(tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", logits_network(), THREE)))
    scores = network.scores(painted(16, 24), k=3)
    x = np.array([200 / 255, 0, 0])
    expected = np.exp([2 * x[0], -x[0], -x[0]])
    assert scores.classes.shape == scores.steps.shape == (16, 24, 3)
    assert scores.covered == (16, 24)
    assert scores.classes[0, 0, 0] == CAR
    probabilities = np.exp(scores.steps / -32.0)
    assert probabilities[0, 0, 0] == pytest.approx(expected[0] / expected.sum(), rel=0.5 / 32)
    assert probabilities.sum(axis=2) == pytest.approx(np.ones((16, 24)), rel=0.5 / 32)


def test_a_network_with_an_arg_max_only_has_no_scores(tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", ids_network(64), IDS)))
    with pytest.raises(ModelError, match="arg max"):
        network.scores(painted(64, 64))
    left, right = network.label_images((painted(64, 64), painted(64, 64)[::-1]))
    assert left.scores is None
    assert right.scores is None
    assert np.array_equal(left.labels, network.labels(painted(64, 64)))


@pytest.mark.parametrize("several", [True, False])
def test_a_pair_gets_the_labels_and_scores_of_its_images(several: bool, tmp_path: Path) -> None:
    network = Network(find_model(put(tmp_path, "made", logits_network(pool=4, count="n" if several else 1), THREE)))
    rng = np.random.default_rng(0)
    left, right = rng.integers(0, 255, (2, 37, 53, 3)).astype(np.uint8)
    for image, labelled in zip((left, right), network.label_images((left, right), k=2), strict=True):
        assert labelled.scores is not None
        assert np.array_equal(labelled.labels, network.labels(image))
        alone = network.scores(image, k=2)
        assert np.array_equal(labelled.scores.classes, alone.classes)
        assert np.array_equal(labelled.scores.steps, alone.steps)
        assert labelled.scores.covered == (40, 56)


@pytest.mark.parametrize("zoom", [0.5, 1.25, 2.0])
def test_an_enlarged_frame_is_labelled_in_its_own_size(zoom: float, tmp_path: Path) -> None:
    toml = put(tmp_path, "made", logits_network(pool=4), THREE + f"zoom = {zoom}\n")
    network = Network(find_model(toml))
    labels = network.labels(painted(60, 120))
    wrong = np.flatnonzero((labels != truth(60, 120, SKY)).any(axis=0))
    assert labels.shape == (60, 120)
    assert all(min(abs(column - 39.5), abs(column - 79.5)) < 3 / min(zoom, 1) for column in wrong)
    assert network.scores(painted(60, 120)).covered == (60, 120)
    ids = Network(find_model(put(tmp_path, "ids", ids_of_any_size(), THREE + f'output = "ids"\nzoom = {zoom}\n')))
    assert (ids.labels(painted(60, 120)) == truth(60, 120, SKY)).mean() > 0.95


def test_a_device_that_is_not_there_is_told_before_the_work(tmp_path: Path) -> None:
    toml = put(tmp_path, "made", logits_network(), THREE)
    absent = next(name for name in ("cuda", "coreml", "tensorrt", "openvino") if name not in available_devices())
    with pytest.raises(ModelError, match=absent) as caught:
        Network(find_model(toml), device=absent)
    assert "cpu" in str(caught.value)
    with pytest.raises(ModelError, match="auto, cpu"):
        Network(find_model(toml), device="abacus")
    assert Network(find_model(toml), device="cpu").device == "cpu"
    assert Network(find_model(toml)).device in available_devices()


def naive_upsampling(logits: np.ndarray, padded: tuple[int, int], height: int, width: int) -> np.ndarray:
    """Each pixel's score of each class by the definition, in float64."""
    gh, gw, _ = logits.shape
    scores = np.zeros((height, width, logits.shape[2]))
    for v in range(height):
        for u in range(width):
            sv = np.clip((v + 0.5) * gh / padded[0] - 0.5, 0, gh - 1)
            su = np.clip((u + 0.5) * gw / padded[1] - 0.5, 0, gw - 1)
            for r in range(gh):
                for c in range(gw):
                    scores[v, u] += max(0, 1 - abs(sv - r)) * max(0, 1 - abs(su - c)) * logits[r, c]
    return scores


@pytest.mark.parametrize(("stride", "height", "width"), [(4, 16, 20), (8, 21, 19), (1, 5, 7), (4, 13, 18)])
def test_the_upsampling_kernel_agrees_with_its_twin(stride: int, height: int, width: int) -> None:
    rng = np.random.default_rng(stride + height)
    gh, gw = -(-height // stride), -(-width // stride)
    logits = rng.normal(size=(gh, gw, 5)).astype(np.float32)
    labels = upsampled_argmax(logits, gh * stride, gw * stride, height, width)
    scores = naive_upsampling(logits, (gh * stride, gw * stride), height, width)
    chosen = np.take_along_axis(scores, labels[..., None].astype(int), axis=2)[..., 0]
    assert np.allclose(chosen, scores.max(axis=2), atol=1e-5)
    assert np.array_equal(labels, upsampled_argmax.py_func(logits, gh * stride, gw * stride, height, width))


def test_bytes_are_scaled_as_the_description_says_in_either_order_of_the_axes() -> None:
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (7, 9, 3)).astype(np.uint8)
    levels = rng.normal(size=(3, 256)).astype(np.float32)
    planes, pixels = np.empty((3, 7, 9), np.float32), np.empty((7, 9, 3), np.float32)
    scaled_planes(image, levels, planes)
    scaled_pixels(image, levels, pixels)
    expected = np.stack([levels[c][image[:, :, c]] for c in range(3)])
    assert np.array_equal(planes, expected)
    scaled_grey(image[:, :, 1].copy(), levels, planes)
    assert np.array_equal(planes, levels[:, image[:, :, 1]])
    assert np.array_equal(pixels, expected.transpose(1, 2, 0))


def test_values_that_are_not_finite_lead_only_where_they_are_weighed() -> None:
    rng = np.random.default_rng(3)
    logits = np.repeat(np.repeat(rng.normal(0, 4, (4, 5, 6)), 2, axis=0), 2, axis=1).astype(np.float32)
    for odd in (np.nan, np.inf, -np.inf):
        with_some = logits.copy()
        with_some[rng.integers(0, 8, 4), rng.integers(0, 10, 4), rng.integers(0, 6, 4)] = odd
        labels, expected = (upsampled_argmax(values, 32, 40, 32, 40) for values in (with_some, logits))
        beside = cv2.dilate((~np.isfinite(with_some)).any(axis=2).astype(np.uint8), np.ones((3, 3), np.uint8))
        far = cv2.resize(beside, (40, 32), interpolation=cv2.INTER_NEAREST) == 0
        assert far.any()
        assert np.array_equal(labels[far], expected[far])


@pytest.mark.parametrize("step", [0.0, 0.5, 1.0])
def test_where_a_class_leads_in_two_columns_it_leads_between_them(step: float) -> None:
    """Patches of classes, with ties (step 0.5 and 1 round the logits) and values far apart, beside every pixel weighed in full."""
    rng = np.random.default_rng(7)
    logits = np.repeat(np.repeat(rng.normal(0, 4, (4, 5, 6)), 4, axis=0), 4, axis=1) + rng.normal(0, 0.3, (16, 20, 6))
    logits = (np.round(logits / step) * step if step else logits * 10 ** rng.uniform(-3, 3, (16, 20, 1))).astype(np.float32)
    labels = upsampled_argmax(logits, 128, 160, 121, 157)
    av, v0 = np.modf(np.clip((np.arange(121) + 0.5) / 8 - 0.5, 0, 15))
    au, u0 = np.modf(np.clip((np.arange(157) + 0.5) / 8 - 0.5, 0, 19))
    v, u = v0.astype(int), u0.astype(int)
    av, au = av.astype(np.float32)[:, None, None], au.astype(np.float32)[:, None]
    rows = logits[v] + av * (logits[np.minimum(v + 1, 15)] - logits[v])
    assert np.array_equal(labels, (rows[:, u] + au * (rows[:, np.minimum(u + 1, 19)] - rows[:, u])).argmax(axis=2))


def test_tiles_cover_everything_once_and_overlap() -> None:
    for length, across in [(1408, 376), (1241, 376), (704, 188), (480, 360), (100, 100), (90, 100)]:
        tiles = tiles_along(length, across)
        assert [t.keep_start for t in tiles] == [0, *(t.keep_stop for t in tiles[:-1])]
        assert tiles[-1].keep_stop == length
        assert all(0 <= t.start <= t.keep_start < t.keep_stop <= t.stop <= length for t in tiles)
        assert all(a.stop > b.start for a, b in itertools.pairwise(tiles))
    assert len(tiles_along(1224, 370)) == 3


WRONG = {
    "two inputs": (
        model(
            [node("Add", ["a", "b"], "c")], [], [value(n, FLOAT, 1, 3, "h", "w") for n in "ab"], [value("c", FLOAT, 1, 3, "h", "w")]
        ),
        THREE,
        "2 inputs",
    ),
    "rank": (
        model([node("Relu", ["a"], "b")], [], [value("a", FLOAT, 3, "h", "w")], [value("b", FLOAT, 3, "h", "w")]),
        THREE,
        "shape",
    ),
    "layout": (logits_network(), THREE + 'layout = "NHWC"\n', "layout"),
    "dtype": (logits_network(), THREE + 'dtype = "uint8"\n', "uint8"),
    "dtype of bytes": (ids_network(64), IDS.replace("uint8", "float32"), "float32"),
    "class count": (logits_network(classes=5), THREE, "5 classes"),
    "size": (ids_network(64), IDS.replace("64", "96"), "96x96"),
    "ids said, logits given": (logits_network(), THREE + 'output = "ids"\n', "class id"),
    "logits said, ids given": (ids_network(64), IDS.replace('"ids"', '"logits"'), "logits"),
    "grey network": (
        model([node("Relu", ["a"], "b")], [], [value("a", FLOAT, 1, 1, "h", "w")], [value("b", FLOAT, 1, 1, "h", "w")]),
        THREE,
        "RGB",
    ),
    "weights elsewhere": (logits_network(external=True), THREE, "other files"),
    "unknown operator": (
        model([node("Surprise", ["a"], "b")], [], [value("a", FLOAT, 1, 3, "h", "w")], [value("b", FLOAT, 1, 3, "h", "w")]),
        THREE,
        "cannot load",
    ),
    "no onnx": (b"\x80\x04\x95pickle", THREE, "not an ONNX file"),
    "empty": (b"", THREE, "not an ONNX file"),
    "truncated": (logits_network()[:-20], THREE, "not an ONNX file"),
    "text": (b"<html>not found</html>", THREE, "not an ONNX file"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_network_that_does_not_fit_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    data, toml, fault = WRONG[case]
    description = find_model(put(tmp_path, "wrong", data, toml))
    with pytest.raises(ModelError, match=fault) as caught:
        Network(description)
    assert "\n" not in str(caught.value)
    assert "wrong.onnx" in str(caught.value)


def test_no_cut_of_a_file_crashes_the_check() -> None:
    data = logits_network()
    check_onnx(data, "whole.onnx")
    refused = 0
    for end in range(len(data)):
        try:
            check_onnx(data[:end], "cut.onnx")
        except ModelError:
            refused += 1
    assert refused > 0.9 * len(data)


def test_ids_that_the_description_does_not_name_are_void(tmp_path: Path) -> None:
    toml = IDS.replace("[13, 8, 255]", "[13, 8]")
    labels = Network(find_model(put(tmp_path, "made", ids_network(64), toml))).labels(painted(64, 64))
    assert np.array_equal(np.unique(labels), [VEGETATION, CAR, 255])


def test_the_description_says_how_pixels_are_scaled(tmp_path: Path) -> None:
    toml = PLAIN.replace("mean = [0.0, 0.0, 0.0]", "mean = [0.9, 0.0, 0.0]") + "classes = [13, 8, 10]\nmultiple = 8\n"
    image = np.full((8, 8, 3), (200, 190, 0), np.uint8)
    assert (Network(find_model(put(tmp_path, "made", logits_network(), THREE))).labels(image) == CAR).all()
    assert (Network(find_model(put(tmp_path, "shifted", logits_network(), toml))).labels(image) == VEGETATION).all()


def test_the_number_of_threads_does_not_change_the_labels(clip_b: Path) -> None:
    image = cv2.imread(str(clip_b / "image_02" / "data" / "0000000100.jpg"))[..., ::-1]
    one, two = (Network(MODELS[DEFAULT_MODEL], threads).labels(image) for threads in (1, 2))
    assert np.array_equal(one, two)


@pytest.mark.parametrize(("height", "width"), [(188, 704), (376, 1408), (376, 1241)])
def test_the_default_network_labels_every_usual_size_in_time(height: int, width: int) -> None:
    network = Network(MODELS[DEFAULT_MODEL])
    image = np.random.default_rng(0).integers(0, 255, (height, width, 3)).astype(np.uint8)
    network.labels(image)
    started = time.process_time()
    labels = network.labels(image)
    assert time.process_time() - started < 0.6 * height * width / (376 * 1408) + 0.3
    assert labels.shape == (height, width)
    assert labels.max() < 19


def resident_mb() -> float:
    """What this process holds. A machine without /proc is a failure in CI and a skip elsewhere."""
    file = Path("/proc/self/statm")
    if not file.exists():
        (pytest.fail if os.environ.get("CI") else pytest.skip)("memory is read from /proc")
    return int(file.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_what_a_network_keeps_for_the_next_images_can_be_given_back(tmp_path: Path) -> None:
    network, image = Network(find_model(put(tmp_path, "made", logits_network(), THREE))), painted(2000, 3000)
    first = network.labels(image)
    held = resident_mb()
    network.give_back()
    assert resident_mb() < held - 60.0  # logits of three classes are 72 MB
    assert np.array_equal(network.labels(image), first)
