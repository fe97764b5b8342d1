"""Published weights become ONNX without PyTorch: the network is the published one, and a file of weights can run nothing."""

import contextlib
import hashlib
import io
import pickle
import sys
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
import pytest

from wayloom.errors import MissingExtraError, ModelError
from wayloom.segmentation.catalogue import MODELS, find_model
from wayloom.segmentation.conversion.convert import convert
from wayloom.segmentation.conversion.efficientvit import _Builder, build_efficientvit_b0
from wayloom.segmentation.conversion.onnx_writer import GraphWriter
from wayloom.segmentation.conversion.state_dict import Tensors, read_state_dict
from wayloom.segmentation.download import fetch
from wayloom.segmentation.network import Network
from wayloom.segmentation.onnx_file import check_onnx

WEIGHTS = "efficientvit-b0-cityscapes/efficientvit_seg_b0_cityscapes.pt"


@pytest.fixture(scope="module")
def weights(models_dir: Path) -> Path:
    return models_dir / WEIGHTS


@pytest.fixture(scope="module")
def tensors(weights: Path) -> Tensors:
    return read_state_dict(weights)


@pytest.fixture(scope="module")
def network(weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Network:
    return Network(find_model(convert("efficientvit-b0", weights, tmp_path_factory.mktemp("made") / "vit.onnx")))


def reference(models_dir: Path, name: str) -> np.ndarray:
    with np.load(models_dir / "efficientvit-b0-cityscapes" / "reference" / f"{name}_logits_1248x384.npz") as archive:
        return np.asarray(archive["logits"].transpose(1, 2, 0), np.float32)


def frame(path: Path) -> np.ndarray:
    return cv2.resize(cv2.imread(str(path)), (1248, 384), interpolation=cv2.INTER_LINEAR)[..., ::-1]


@pytest.mark.models
@pytest.mark.real_data
@pytest.mark.parametrize("name", ["000002_10", "0000000100"])
def test_the_converted_network_gives_the_published_networks_logits(
    name: str, network: Network, models_dir: Path, data_dir: Path, clip_b: Path
) -> None:
    folders = {"000002_10": data_dir / "labelled/kitti/image/000002_10.png"}
    as_published = Network(network.description.model_copy(update={"zoom": 1.0}))
    logits = as_published.logits(frame(folders.get(name, clip_b / "image_02" / "data" / f"{name}.jpg")))
    expected = reference(models_dir, name)
    assert logits.shape == expected.shape == (48, 156, 19)
    assert (logits.argmax(2) == expected.argmax(2)).mean() >= 0.995
    # The reference is float16: 2^-11 of the largest logits, about 30, is 0.015.
    assert np.abs(logits - expected).max() < 0.03


@pytest.mark.models
def test_the_catalogue_knows_the_converted_file_and_the_weights_by_their_checksums(weights: Path, network: Network) -> None:
    assert network.sha256 == MODELS["efficientvit-b0"].sha256
    assert hashlib.sha256(weights.read_bytes()).hexdigest() == MODELS["efficientvit-b0"].url_sha256


@pytest.mark.models
def test_any_size_of_image_is_labelled_whole(network: Network) -> None:
    rng = np.random.default_rng(0)
    for height, width in [(188, 704), (376, 1241), (50, 70)]:
        labels = network.labels(rng.integers(0, 255, (height, width, 3)).astype(np.uint8))
        assert labels.shape == (height, width)
        assert labels.max() < 19


@pytest.mark.parametrize("times", [2, 4])
@pytest.mark.parametrize(("rows", "columns"), [(1, 5), (2, 3), (15, 48)])
def test_enlargement_by_matrices_is_bicubic(times: int, rows: int, columns: int) -> None:
    builder = _Builder({})
    graph = builder.graph
    graph.name_output(builder._enlarged("x", times), "y")
    scales = graph.constant(np.array([1, 1, times, times], np.float32))
    how = {"coordinate_transformation_mode": "pytorch_half_pixel", "mode": "cubic", "cubic_coeff_a": -0.75}
    graph.name_output(graph.node("Resize", "x", "", scales, **how), "z")
    data = graph.model({"x": ("n", 3, "h", "w")}, dict.fromkeys("yz", ("n", 3, "rows", "columns")), "made")
    x = np.random.default_rng(0).normal(size=(2, 3, rows, columns)).astype(np.float32)
    enlarged, expected = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"]).run(None, {"x": x})
    assert enlarged.shape == expected.shape == (2, 3, times * rows, times * columns)
    assert np.abs(enlarged - expected).max() < 1e-5


@pytest.mark.models
def test_weights_of_another_network_are_refused(tensors: Tensors) -> None:
    with pytest.raises(ModelError, match="no tensor backbone"):
        build_efficientvit_b0({name: values for name, values in tensors.items() if not name.startswith("backbone")})
    with pytest.raises(ModelError, match=r"1 tensors are no part.*surprise"):
        build_efficientvit_b0({**tensors, "surprise": np.zeros(3, np.float32)})


@pytest.mark.models
def test_weights_of_another_shape_leave_no_file(tensors: Tensors, tmp_path: Path) -> None:
    wrong = {**tensors, "head.input_ops.0.op_list.0.conv.weight": np.zeros((32, 64, 1, 1), np.float32)}
    write_state_dict(tmp_path / "wrong.pt", wrong)
    with pytest.raises(ModelError):
        convert("efficientvit-b0", tmp_path / "wrong.pt", tmp_path / "vit.onnx")
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.pt"]


def test_what_cannot_be_converted_is_told_before_the_work(tmp_path: Path) -> None:
    for name, out, fault in [
        ("resnet", tmp_path / "a.onnx", "efficientvit-b0"),
        ("efficientvit-b0", tmp_path / "a.pt", "ONNX"),
        ("efficientvit-b0", tmp_path / "none" / "a.onnx", "folder"),
        ("efficientvit-b0", tmp_path / "a.onnx", "no such file"),
    ]:
        with pytest.raises(ModelError, match=fault):
            convert(name, tmp_path / "none.pt", out)


def test_without_the_package_onnx_nothing_is_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("efficientvit", "onnx_writer"):
        monkeypatch.delitem(sys.modules, f"wayloom.segmentation.conversion.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'wayloom\[convert\]'"):
        fetch(MODELS["efficientvit-b0"], tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_graph_is_checked_when_it_is_written() -> None:
    from onnx.checker import ValidationError

    graph = GraphWriter()
    graph.name_output(graph.node("Relu", "nowhere"), "y")
    with pytest.raises(ValidationError, match="nowhere"):
        graph.model({"x": ("n",)}, {"y": ("n",)}, "made")


class _Storage:
    def __init__(self, values: np.ndarray) -> None:
        self.values = values


class _Call:
    """Pickled as a call of a global name."""

    def __init__(self, module: str, name: str, *arguments: Any) -> None:
        self.what, self.arguments = (module, name), arguments


class _Pickler(pickle._Pickler):  # the one in Python, whose opcodes a test may write by hand
    """Writes what torch.save writes."""

    def persistent_id(self, obj: Any) -> Any:
        if isinstance(obj, _Storage):
            kinds = {"f4": "FloatStorage", "i8": "LongStorage", "f2": "HalfStorage", "f8": "DoubleStorage"}
            key = str(len(self.storages))
            self.storages[key] = obj.values
            return ("storage", _Call("torch", kinds[obj.values.dtype.str[1:]]), key, "cpu", obj.values.size)
        return None

    def save(self, obj: Any, save_persistent_id: bool = True) -> None:
        if isinstance(obj, _Call):
            self.write(pickle.GLOBAL + f"{obj.what[0]}\n{obj.what[1]}\n".encode())
            if obj.arguments:
                self.save(obj.arguments)
                self.write(pickle.REDUCE)
            return
        super().save(obj, save_persistent_id)


def write_pickle(path: Path, content: Any) -> None:
    buffer = io.BytesIO()
    pickler = _Pickler(buffer, protocol=2)
    pickler.storages = {}
    pickler.dump(content)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("made/data.pkl", buffer.getvalue())
        for key, values in pickler.storages.items():
            archive.writestr(f"made/data/{key}", values.tobytes())


def made_tensor(values: np.ndarray, offset: int = 0, stride: tuple[int, ...] | None = None, shape: Any = None) -> _Call:
    steps = stride or tuple(s // values.itemsize for s in values.strides)
    storage = _Storage(values.ravel())
    return _Call("torch._utils", "_rebuild_tensor_v2", storage, offset, shape or values.shape, steps, False, OrderedDict())


def write_state_dict(path: Path, tensors: Tensors) -> None:
    write_pickle(path, {"state_dict": {name: made_tensor(np.ascontiguousarray(v)) for name, v in tensors.items()}})


def test_tensors_come_back_whatever_their_type_and_layout(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    write_pickle(
        tmp_path / "made.pt",
        {
            "plain": made_tensor(values),
            "turned": made_tensor(values, 0, (1, 4), (4, 3)),
            "part": made_tensor(values, 5, (4,), (2,)),
            "half": made_tensor(np.array([0.5, 2], np.float16)),
            "count": made_tensor(np.array(7, np.int64)),
            "none": made_tensor(np.zeros((0, 3), np.float32)),
        },
    )
    found = read_state_dict(tmp_path / "made.pt")
    assert np.array_equal(found["plain"], values)
    assert np.array_equal(found["turned"], values.T)
    assert found["part"].tolist() == [5, 9]
    assert found["half"].tolist() == [0.5, 2]
    assert found["count"] == 7
    assert found["none"].shape == (0, 3)


WICKED: dict[str, Callable[[Path], Any]] = {
    "a command": lambda path: _Call("os", "system", f"touch {path}"),
    "an opened file": lambda path: _Call("builtins", "open", str(path), "w"),
    "evaluated text": lambda path: {"w": _Call("builtins", "eval", f"open({str(path)!r}, 'w')")},
    "numpy's own pickles": lambda path: {"w": _Call("numpy.core.multiarray", "_reconstruct", 1)},
    "an attribute of what is known": lambda path: {"w": _Call("torch._utils", "_rebuild_tensor_v2.__globals__", 1)},
    "another torch function": lambda path: {"w": _Call("torch.hub", "load", "x")},
}


@pytest.mark.parametrize("case", WICKED)
def test_a_pickle_that_asks_for_more_than_tensors_is_not_run(case: str, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    write_pickle(tmp_path / "wicked.pt", WICKED[case](trace))
    with pytest.raises(ModelError, match="more than weights") as caught:
        read_state_dict(tmp_path / "wicked.pt")
    assert not trace.exists()
    assert "\n" not in str(caught.value)


WRONG: dict[str, Callable[[], Any]] = {
    "beyond its storage": lambda: {"w": made_tensor(np.zeros(3, np.float32), 1, (1,), (3,))},
    "negative stride": lambda: {"w": made_tensor(np.zeros(3, np.float32), 2, (-1,), (3,))},
    "a number": lambda: {"w": 3},
    "nothing": dict,
    "a list": lambda: [1, 2],
    "rank": lambda: {"w": made_tensor(np.zeros(3, np.float32), 0, (1, 1), (3,))},
    "huge by stride 0": lambda: {"w": made_tensor(np.zeros(3, np.float32), 0, (0, 0, 0), (1 << 30, 1 << 30, 1 << 30))},
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_state_dict_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    write_pickle(tmp_path / "wrong.pt", WRONG[case]())
    with pytest.raises(ModelError, match=r"wrong\.pt") as caught:
        read_state_dict(tmp_path / "wrong.pt")
    assert "\n" not in str(caught.value)


def test_no_cut_of_a_file_of_weights_crashes_the_reader(tmp_path: Path) -> None:
    write_state_dict(tmp_path / "whole.pt", {"a": np.ones((2, 3), np.float32), "b": np.zeros(4, np.float32)})
    data = (tmp_path / "whole.pt").read_bytes()
    rng = np.random.default_rng(0)
    for end in range(0, len(data), 7):
        (tmp_path / "cut.pt").write_bytes(data[:end])
        with pytest.raises(ModelError):
            read_state_dict(tmp_path / "cut.pt")
    for _ in range(300):
        torn = bytearray(data)
        for at in rng.integers(0, len(data), 3):
            torn[at] = rng.integers(0, 256)
        (tmp_path / "torn.pt").write_bytes(torn)
        with contextlib.suppress(ModelError):
            read_state_dict(tmp_path / "torn.pt")


@pytest.mark.models
def test_the_written_file_is_read_by_our_own_check(tensors: Tensors) -> None:
    data = build_efficientvit_b0(tensors)
    check_onnx(data, "vit.onnx")
    assert data == build_efficientvit_b0(dict(reversed(tensors.items())))
